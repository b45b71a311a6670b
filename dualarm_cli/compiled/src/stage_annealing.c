/* Simulated annealing of an order of two arms' stages: `orders/paired/orders.py` explains it. */

#include <math.h>
#include <stdint.h>
#include <string.h>

enum { ARMS = 2, MOST_ANGLES = 256, MOST_STAGES = 16 };

static const int64_t IDLE = -1;
static const double NEVER = 1e6;   /* more than anything takes [s] */
static const double LITTLE = 1e-9; /* totals that differ by less are the same [s] */

/* Stages of `stops` stops at `angles` platform angles. Lengths, by arm (stops + 1, stops + 2, angles, angles): from a
   stop, at an angle, to another, at another; the row `stops` is the start, the column `stops` the way back, the one after
   it nothing. The least of all angles, by arm (stops + 1, stops + 2). Apart (stops + 2, stops + 2, angles) may be null. */
typedef struct {
    const float *length[ARMS], *least[ARMS];
    const float *apart;
    const double *turns_back; /* how long the platform takes back from each angle, (angles,) */
    int64_t stops, angles, free_start;
} Problem;

/* Tasks: where the stops of each begin in `stop`, (tasks + 1,); by stop, and for the start, its task and whether another
   one of it follows, (stops + 1,). All tasks in the order of how many stops they have, and by task where those of as many
   begin and end in it, (tasks, 2); other tasks that are near each, (tasks, nears). */
typedef struct {
    const int64_t *begin, *stop, *task, *inner, *sorted, *alike, *near;
    int64_t tasks, nears, singles; /* singles: whether all of them have one stop */
} Tasks;

/* An order, start and way back included, `count` stages: stops, what came before them, and the next stage in which each arm
   has a stop, (stages, 2); angles, lengths, and lengths in the opposite order, (stages,); sums over all stages before each
   of both, and of stages in which an arm is idle, (stages + 1,). The stage and the arm of every stop, (stops, 2). Stages
   and arms, 2 k + a, in which an arm is idle and not amid a task; stages before which a run may begin: both arms go on
   there, and neither is amid a task. */
typedef struct {
    int64_t *rows, *came, *next, *angle;
    double *cost, *turned, *sum, *turned_sum;
    int64_t *halves, *place, *idle, *cut, *best_rows;
    int64_t count, idles, cuts, best_count;
    double best, claimed; /* total of the best order; what all changes were said to be worth */
    uint64_t random;
} Line;

/* How hard: exchanges, changes within a few stages, and moves of runs that are tried in each round; so many stages those
   changes are, round after round; shares of exchanges with a task far away, with an idle arm, and with a stage of its own. */
typedef struct {
    int64_t exchanges, changes, moves, widths;
    const int64_t *width;
    double far, idle, alone;
} Shares;

/* A change: `width` stages in the place of `old` ones from `first` on; what follows from it, see `priced`. */
typedef struct {
    int64_t first, old, width, last, at;
    int64_t stops[MOST_STAGES][ARMS], from[MOST_STAGES + 1][ARMS];
    double values[MOST_STAGES + 1][MOST_ANGLES];
} Change;

/* SplitMix64. */
static uint64_t drawn(Line *line)
{
    uint64_t x = line->random += 0x9e3779b97f4a7c15u;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return x ^ (x >> 31);
}

/* A number from 0 to below 1. */
static double uniform(Line *line)
{
    return (double)(drawn(line) >> 11) * 0x1p-53;
}

/* A whole number from 0 to below another one. */
static int64_t below(Line *line, int64_t end)
{
    return (int64_t)(((drawn(line) >> 32) * (uint64_t)end) >> 32);
}

/* By how much a change may make all later. */
static double allowed(Line *line, double warm)
{
    return -warm * log(1.0 - uniform(line));
}

static int is_empty(const int64_t stop[ARMS])
{
    return stop[0] == IDLE && stop[1] == IDLE;
}

/* Lengths of an arm's part of a stage between all pairs of angles. */
static const float *lengths_of(const Problem *problem, int arm, int64_t came, int64_t stop)
{
    const int64_t column = stop == IDLE ? problem->stops + 1 : stop;
    return problem->length[arm] + (came * (problem->stops + 2) + column) * problem->angles * problem->angles;
}

/* What a stage takes at least, at whichever angles. */
static double floor_of(const Problem *problem, const int64_t came[ARMS], const int64_t stop[ARMS])
{
    double found = 0.0;
    for (int a = 0; a < ARMS; a++)
        if (stop[a] != IDLE && stop[a] != problem->stops) {
            const double own = problem->least[a][came[a] * (problem->stops + 2) + stop[a]];
            found = own > found ? own : found;
        }
    return found;
}

static double apart_at(const Problem *problem, const int64_t stop[ARMS], int64_t angle)
{
    const int64_t side = problem->stops + 2;
    if (!problem->apart || stop[0] == problem->stops)
        return 0.0;
    const int64_t one = stop[0] == IDLE ? side - 1 : stop[0], other = stop[1] == IDLE ? side - 1 : stop[1];
    return problem->apart[(one * side + other) * problem->angles + angle];
}

/* How long a stage takes to its angle, from those of [begin, end); the way back where its stop is the home of both. */
static void length_to(const Problem *problem, const int64_t came[ARMS], const int64_t stop[ARMS], int64_t angle,
                      int64_t begin, int64_t end, double *length)
{
    const int64_t home = problem->stops, f = problem->angles;
    const int back = stop[0] == home;
    const float *own[ARMS];
    for (int a = 0; a < ARMS; a++)
        /* An arm that never left has no way back. */
        own[a] = lengths_of(problem, a, came[a], back && came[a] == home ? IDLE : stop[a]);
    const double apart = apart_at(problem, stop, angle);
    for (int64_t k = begin; k < end; k++) {
        const float one = own[0][k * f + angle], other = own[1][k * f + angle];
        const double longest = (double)(one > other ? one : other) + apart;
        length[k - begin] = back && problem->turns_back[k] > longest ? problem->turns_back[k] : longest;
    }
}

static double length_at(const Problem *problem, const int64_t came[ARMS], const int64_t stop[ARMS], int64_t from, int64_t angle)
{
    double found;
    length_to(problem, came, stop, angle, from, from + 1, &found);
    return found;
}

/* When a stage is over at each angle, given when the one before is over at those of [begin, end). */
static void stage_over(const Problem *problem, const int64_t came[ARMS], const int64_t stop[ARMS], const double *before,
                       int64_t begin, int64_t end, double *restrict over)
{
    const int64_t f = problem->angles;
    const float *one = lengths_of(problem, 0, came[0], stop[0]), *other = lengths_of(problem, 1, came[1], stop[1]);
    for (int64_t g = 0; g < f; g++)
        over[g] = INFINITY;
    for (int64_t k = begin; k < end; k++) {
        const double so_far = before[k];
        if (!(so_far < INFINITY))
            continue;
        const float *x = one + k * f, *y = other + k * f;
        for (int64_t g = 0; g < f; g++) {
            const double sum = so_far + (double)(x[g] > y[g] ? x[g] : y[g]);
            over[g] = sum < over[g] ? sum : over[g];
        }
    }
    if (problem->apart)
        for (int64_t g = 0; g < f; g++)
            over[g] += apart_at(problem, stop, g);
}

/* The angle from which a stage at another one is over first, given when the stage before is over at each. */
static int64_t best_before(const Problem *problem, const int64_t came[ARMS], const int64_t stop[ARMS], int64_t angle,
                           const double *value)
{
    const int64_t f = problem->angles;
    const float *one = lengths_of(problem, 0, came[0], stop[0]), *other = lengths_of(problem, 1, came[1], stop[1]);
    double least = INFINITY;
    int64_t best = 0;
    for (int64_t k = 0; k < f; k++) {
        const float x = one[k * f + angle], y = other[k * f + angle];
        const double sum = value[k] + (double)(x > y ? x : y);
        if (sum < least) {
            least = sum;
            best = k;
        }
    }
    return best;
}

/* Computes lengths anew from stage `begin` to `end`, both included. */
static void measure_lengths(const Problem *problem, const Tasks *tasks, Line *line, int64_t begin, int64_t end)
{
    int64_t *rows = line->rows, *came = line->came, *angle = line->angle;
    const int64_t n = line->count;
    for (int64_t k = begin; k < n; k++)
        for (int a = 0; a < ARMS; a++)
            came[ARMS * k + a] = rows[ARMS * (k - 1) + a] == IDLE ? came[ARMS * (k - 1) + a] : rows[ARMS * (k - 1) + a];
    for (int64_t k = begin; k <= end; k++)
        line->cost[k] = length_at(problem, came + ARMS * k, rows + ARMS * k, angle[k - 1], angle[k]);
    for (int64_t k = begin - 1; tasks->singles && k <= end; k++) {
        const int64_t *row = rows + ARMS * k;
        const int turns = k > 0 && k < n - 2 && row[0] != IDLE && row[1] != IDLE && row[2] != IDLE && row[3] != IDLE;
        const double turned = turns ? length_at(problem, row + ARMS, row, angle[k + 1], angle[k]) : 0.0;
        line->turned[k] = turned < NEVER ? turned : NEVER;
    }
}

/* Computes all else that follows from stops and angles, and keeps the best order. */
static void measure(const Tasks *tasks, Line *line)
{
    const int64_t n = line->count;
    line->idles = line->cuts = 0;
    for (int64_t k = 0; k < n; k++) {
        const int64_t *row = line->rows + ARMS * k, *came = line->came + ARMS * k;
        const int half = row[0] == IDLE || row[1] == IDLE;
        line->sum[k + 1] = line->sum[k] + line->cost[k];
        line->turned_sum[k + 1] = line->turned_sum[k] + line->turned[k];
        line->halves[k + 1] = line->halves[k] + half;
        if (k > 0 && !half && !tasks->inner[came[0]] && !tasks->inner[came[1]])
            line->cut[line->cuts++] = k;
        for (int a = 0; a < ARMS && k > 0 && k < n - 1; a++)
            if (row[a] != IDLE) {
                line->place[ARMS * row[a]] = k;
                line->place[ARMS * row[a] + 1] = a;
            } else if (!tasks->inner[came[a]])
                line->idle[line->idles++] = ARMS * k + a;
    }
    for (int64_t k = n - 1; k >= 0; k--)
        for (int a = 0; a < ARMS; a++)
            line->next[ARMS * k + a] = line->rows[ARMS * k + a] == IDLE ? line->next[ARMS * (k + 1) + a] : k;
    if (line->sum[n] < line->best - LITTLE) {
        line->best = line->sum[n];
        line->best_count = n;
        memcpy(line->best_rows, line->rows, (size_t)(ARMS * n) * sizeof *line->rows);
    }
}

/* Computes all anew, without stages in which nothing is left to do. */
static void measure_all(const Problem *problem, const Tasks *tasks, Line *line)
{
    int64_t n = 0;
    for (int64_t k = 0; k < line->count; k++)
        if (!is_empty(line->rows + ARMS * k)) {
            memmove(line->rows + ARMS * n, line->rows + ARMS * k, ARMS * sizeof *line->rows);
            line->angle[n++] = line->angle[k];
        }
    line->count = n;
    measure_lengths(problem, tasks, line, 1, n - 1);
    measure(tasks, line);
}

/* Chooses the best angles for the stages as they are; `over` has room for (stages, angles). */
static void choose_angles(const Problem *problem, const Tasks *tasks, Line *line, double *over)
{
    const int64_t f = problem->angles, n = line->count;
    double rest[MOST_ANGLES];
    for (int64_t g = 0; g < f; g++)
        over[g] = g == 0 || problem->free_start ? 0.0 : INFINITY;
    for (int64_t k = 1; k < n - 1; k++)
        stage_over(problem, line->came + ARMS * k, line->rows + ARMS * k, over + (k - 1) * f, 0, f, over + k * f);
    length_to(problem, line->came + ARMS * (n - 1), line->rows + ARMS * (n - 1), 0, 0, f, rest);
    int64_t at = 0;
    for (int64_t g = 0; g < f; g++) {
        rest[g] += over[(n - 2) * f + g];
        at = rest[g] < rest[at] ? g : at;
    }
    for (int64_t k = n - 2; k > 0; k--) {
        line->angle[k] = at;
        at = best_before(problem, line->came + ARMS * k, line->rows + ARMS * k, at, over + (k - 1) * f);
    }
    line->angle[0] = at;
    measure_all(problem, tasks, line);
}

/* The stage in which an arm goes on that is idle right after a change, and what each arm made before that stage then; 0
   where it comes from where it came from before. */
static int64_t goes_on(const Line *line, const Change *change, int arm, int64_t came[ARMS])
{
    const int64_t end = change->first + change->old;
    if (line->rows[ARMS * end + arm] != IDLE || change->from[change->width][arm] == line->came[ARMS * end + arm])
        return 0;
    const int64_t k = line->next[ARMS * end + arm];
    came[arm] = change->from[change->width][arm];
    came[1 - arm] = line->came[ARMS * k + 1 - arm];
    return k;
}

/* Prepares a change whose stages and stops are there. Returns the least by which it makes all later, at any angles. */
static double prepared(const Problem *problem, const Line *line, Change *change)
{
    const int64_t begin = change->first, end = begin + change->old;
    double found = line->sum[begin] - line->sum[end + 1];
    for (int a = 0; a < ARMS; a++)
        change->from[0][a] = line->came[ARMS * begin + a];
    for (int64_t i = 0; i < change->width; i++) {
        found += floor_of(problem, change->from[i], change->stops[i]);
        for (int a = 0; a < ARMS; a++)
            change->from[i + 1][a] = change->stops[i][a] == IDLE ? change->from[i][a] : change->stops[i][a];
    }
    found += floor_of(problem, change->from[change->width], line->rows + ARMS * end);
    change->last = end;
    for (int a = 0; a < ARMS; a++) {
        int64_t came[ARMS];
        const int64_t k = goes_on(line, change, a, came);
        if (k) {
            found += floor_of(problem, came, line->rows + ARMS * k) - line->cost[k];
            change->last = k;
        }
    }
    return found;
}

/* By how much all is done later with a prepared change, at the angles that suit its stages best between those before and
   after them, which stay; infinite where it cannot be. */
static double priced(const Problem *problem, const Line *line, Change *change)
{
    const int64_t f = problem->angles, begin = change->first, end = begin + change->old, width = change->width;
    int64_t some = line->angle[begin - 1], until = some + 1;
    double rest[MOST_ANGLES];
    for (int64_t g = 0; g < f; g++)
        change->values[0][g] = INFINITY;
    change->values[0][some] = 0.0;
    for (int64_t i = 0; i < width; i++)
        if (is_empty(change->stops[i])) {
            /* Where nobody does anything the platform stays. */
            memcpy(change->values[i + 1], change->values[i], (size_t)f * sizeof(double));
        } else {
            stage_over(problem, change->from[i], change->stops[i], change->values[i], some, until, change->values[i + 1]);
            some = 0;
            until = f;
        }
    length_to(problem, change->from[width], line->rows + ARMS * end, line->angle[end], some, until, rest + some);
    change->at = some;
    for (int64_t g = some; g < until; g++) {
        rest[g] += change->values[width][g];
        change->at = rest[g] < rest[change->at] ? g : change->at;
    }
    double found = rest[change->at] - (line->sum[end + 1] - line->sum[begin]);
    for (int a = 0; a < ARMS; a++) {
        int64_t came[ARMS];
        const int64_t k = goes_on(line, change, a, came);
        if (k)
            found += length_at(problem, came, line->rows + ARMS * k, line->angle[k - 1], line->angle[k]) - line->cost[k];
    }
    return found;
}

/* Makes a priced change; nothing is measured. Returns whether other stages have other numbers then. */
static int made(const Problem *problem, Line *line, const Change *change)
{
    const int64_t more = change->width - change->old, end = change->first + change->old, rest = line->count - end;
    int moved = more != 0;
    if (moved) {
        memmove(line->rows + ARMS * (end + more), line->rows + ARMS * end, (size_t)(ARMS * rest) * sizeof *line->rows);
        memmove(line->angle + end + more, line->angle + end, (size_t)rest * sizeof *line->angle);
        line->count += more;
    }
    int64_t at = change->at;
    for (int64_t i = change->width - 1; i >= 0; i--) {
        const int64_t *stop = change->stops[i], k = change->first + i;
        memcpy(line->rows + ARMS * k, stop, ARMS * sizeof *stop);
        line->angle[k] = at;
        if (is_empty(stop))
            moved = 1;
        else
            at = best_before(problem, change->from[i], stop, at, change->values[i]);
    }
    return moved;
}

/* Sets a change in which an arm makes other stops in some stages, nothing where there are none. */
static void set_stops(const Line *line, Change *change, int64_t first, int64_t arm, const int64_t *stop, int64_t width)
{
    change->first = first;
    change->old = change->width = width;
    memcpy(change->stops, line->rows + ARMS * first, (size_t)(ARMS * width) * sizeof *line->rows);
    for (int64_t i = 0; i < width; i++)
        change->stops[i][arm] = stop ? stop[i] : IDLE;
}

/* Whether the stops of a task are made in stages that follow one another. */
static int is_in_a_row(const Line *line, const int64_t *stop, int64_t width)
{
    for (int64_t i = 1; i < width; i++)
        if (line->place[ARMS * stop[i]] != line->place[ARMS * stop[0]] + i)
            return 0;
    return 1;
}

/* A task to change places with one of as many stops: one near to what comes before the other, or after it. */
static int64_t other_task(const Tasks *tasks, const Shares *shares, Line *line, int64_t task, int64_t home)
{
    const int64_t *stop = tasks->stop + tasks->begin[task], width = tasks->begin[task + 1] - tasks->begin[task];
    const int64_t *place = line->place + ARMS * stop[0], *alike = tasks->alike + 2 * task;
    const int64_t end = place[0] + width < line->count ? place[0] + width : line->count - 1;
    const int64_t *beside = drawn(line) >> 63 ? line->came + ARMS * place[0] : line->rows + ARMS * end;
    if (beside[place[1]] != IDLE && beside[place[1]] != home && uniform(line) >= shares->far) {
        const int64_t found = tasks->near[tasks->task[beside[place[1]]] * tasks->nears + below(line, tasks->nears)];
        if (tasks->begin[found + 1] - tasks->begin[found] == width)
            return found;
    }
    return tasks->sorted[alike[0] + below(line, alike[1] - alike[0])];
}

/* A task changes places with another one, or goes to where an arm is idle, or to stages of its own. */
static void exchange(const Problem *problem, const Tasks *tasks, const Shares *shares, Line *line, double warm)
{
    Change both[2], *one = both, *other = both + 1;
    const int64_t task = below(line, tasks->tasks), width = tasks->begin[task + 1] - tasks->begin[task];
    const int64_t *stop = tasks->stop + tasks->begin[task], *place = line->place + ARMS * stop[0];
    if (width > MOST_STAGES || !is_in_a_row(line, stop, width))
        return;
    const double kind = uniform(line);
    if (kind < shares->alone) {
        const int64_t arm = below(line, ARMS), k = 1 + below(line, line->count - 1);
        if (tasks->inner[line->came[ARMS * k + arm]])
            return;
        set_stops(line, one, place[0], place[1], 0, width);
        other->first = k;
        other->old = 0;
        other->width = width;
        for (int64_t i = 0; i < width; i++) {
            other->stops[i][arm] = stop[i];
            other->stops[i][1 - arm] = IDLE;
        }
    } else if (width == 1 && line->idles && kind < shares->alone + shares->idle) {
        const int64_t slot = line->idle[below(line, line->idles)];
        set_stops(line, one, place[0], place[1], 0, 1);
        set_stops(line, other, slot / ARMS, slot % ARMS, stop, 1);
    } else {
        const int64_t *then = tasks->stop + tasks->begin[other_task(tasks, shares, line, task, problem->stops)];
        const int64_t *there = line->place + ARMS * then[0];
        if (!is_in_a_row(line, then, width))
            return;
        set_stops(line, one, place[0], place[1], then, width);
        set_stops(line, other, there[0], there[1], stop, width);
    }
    if (one->first > other->first) {
        one = both + 1;
        other = both;
    }
    if (one->first + one->old >= other->first)
        return;
    const double most = allowed(line, warm), floor = prepared(problem, line, one);
    if (one->last >= other->first || floor + prepared(problem, line, other) >= most)
        return;
    const double delta = priced(problem, line, one) + priced(problem, line, other);
    if (!(delta < most))
        return;
    line->claimed += delta;
    /* The later one first, so that the other one's stages keep their numbers. */
    const int moved = made(problem, line, other);
    if (made(problem, line, one) || moved) {
        measure_all(problem, tasks, line);
        return;
    }
    measure_lengths(problem, tasks, line, one->first, one->last);
    measure_lengths(problem, tasks, line, other->first, other->last);
    measure(tasks, line);
}

/* In some stages in a row stops are shifted, turned round or change places; of tasks of one stop each. */
static void change_stages(const Problem *problem, const Tasks *tasks, Line *line, int64_t width, double warm)
{
    Change change;
    int64_t(*stop)[ARMS] = change.stops;
    if (width > line->count - 2 || width > MOST_STAGES)
        return;
    change.first = 1 + below(line, line->count - 1 - width);
    change.old = change.width = width;
    const int64_t *rows = line->rows + ARMS * change.first;
    const int64_t kind = width == 1 ? 0 : below(line, 6), shift = kind == 4 ? 1 : width - 1;
    for (int64_t i = 0; i < width; i++)
        for (int a = 0; a < ARMS; a++) {
            /* Arms change what they do; both, or one of them, shift by a stage. */
            const int shifts = kind == 1 || kind == 4 || kind == 2 + a;
            const int64_t from = shifts ? (i + shift) % width : i;
            stop[i][a] = rows[ARMS * from + (kind == 0 ? 1 - a : a)];
        }
    /* All stops of the stages anyhow. */
    for (int64_t i = kind == 5 ? ARMS * width - 1 : 0; i > 0; i--) {
        const int64_t k = below(line, i + 1), own = stop[i / ARMS][i % ARMS];
        stop[i / ARMS][i % ARMS] = stop[k / ARMS][k % ARMS];
        stop[k / ARMS][k % ARMS] = own;
    }
    const double most = allowed(line, warm);
    if (prepared(problem, line, &change) >= most)
        return;
    const double delta = priced(problem, line, &change);
    if (!(delta < most))
        return;
    line->claimed += delta;
    if (made(problem, line, &change))
        measure_all(problem, tasks, line);
    else {
        measure_lengths(problem, tasks, line, change.first, change.last);
        measure(tasks, line);
    }
}

/* Puts stages [begin, end) into the opposite order, each with its angle; nothing is measured. */
static void turn_round(Line *line, int64_t begin, int64_t end)
{
    for (end--; begin < end; begin++, end--) {
        int64_t *one = line->rows + ARMS * begin, *other = line->rows + ARMS * end;
        for (int a = 0; a < ARMS; a++) {
            const int64_t stop = one[a];
            one[a] = other[a];
            other[a] = stop;
        }
        const int64_t angle = line->angle[begin];
        line->angle[begin] = line->angle[end];
        line->angle[end] = angle;
    }
}

/* A run of stages in which no arm is idle is made in the opposite order; of tasks of one stop each. */
static void reverse(const Problem *problem, const Tasks *tasks, Line *line, double warm)
{
    const int64_t n = line->count - 2, *rows = line->rows, *angle = line->angle;
    const int64_t begin = 1 + below(line, n), reach = begin + 2 + below(line, n), end = reach < n + 1 ? reach : n + 1;
    if (end - begin < 2 || line->halves[end + 1] != line->halves[begin - 1])
        return;
    const double most = allowed(line, warm);
    double delta = line->turned_sum[end - 1] - line->turned_sum[begin] - (line->sum[end + 1] - line->sum[begin]);
    const int64_t *first = rows + ARMS * (end - 1), *last = rows + ARMS * begin;
    if (delta + floor_of(problem, rows + ARMS * (begin - 1), first) + floor_of(problem, last, rows + ARMS * end) >= most)
        return;
    delta += length_at(problem, rows + ARMS * (begin - 1), first, angle[begin - 1], angle[end - 1]);
    delta += length_at(problem, last, rows + ARMS * end, angle[begin], angle[end]);
    if (!(delta < most))
        return;
    line->claimed += delta;
    turn_round(line, begin, end);
    measure_lengths(problem, tasks, line, begin, end);
    measure(tasks, line);
}

static int is_cut(const Tasks *tasks, const Line *line, int64_t k)
{
    const int64_t *row = line->rows + ARMS * k, *came = line->came + ARMS * k;
    return row[0] != IDLE && row[1] != IDLE && !tasks->inner[came[0]] && !tasks->inner[came[1]];
}

/* Two runs of stages that follow one another, [i, j) and [j, p), change places, each stage with its angle. */
static void move(const Problem *problem, const Tasks *tasks, Line *line, double warm)
{
    if (line->cuts < 3)
        return;
    const int64_t x = line->cut[below(line, line->cuts)], y = line->cut[below(line, line->cuts)];
    const int64_t i = x < y ? x : y, p = x < y ? y : x;
    const int64_t *rows = line->rows, *came = line->came, *angle = line->angle;
    /* Short ones go anywhere as often as all others. */
    const int64_t j = drawn(line) >> 63 ? i + 1 + below(line, 3) : line->cut[below(line, line->cuts)];
    if (j <= i || j >= p || !is_cut(tasks, line, j))
        return;
    const double most = allowed(line, warm);
    double delta = -line->cost[i] - line->cost[j] - line->cost[p];
    if (delta + floor_of(problem, came + ARMS * i, rows + ARMS * j) + floor_of(problem, came + ARMS * p, rows + ARMS * i)
            + floor_of(problem, came + ARMS * j, rows + ARMS * p) >= most)
        return;
    delta += length_at(problem, came + ARMS * i, rows + ARMS * j, angle[i - 1], angle[j]);
    delta += length_at(problem, came + ARMS * p, rows + ARMS * i, angle[p - 1], angle[i]);
    delta += length_at(problem, came + ARMS * j, rows + ARMS * p, angle[j - 1], angle[p]);
    if (!(delta < most))
        return;
    line->claimed += delta;
    turn_round(line, i, j);
    turn_round(line, j, p);
    turn_round(line, i, p);
    measure_lengths(problem, tasks, line, i, p);
    measure(tasks, line);
}

/* Some rounds from round `round` on, at temperatures [s] that begin at `warm` and fall by a factor with each; then all
   angles are chosen anew. `over` has room for (stages, angles). Returns 0, or 1 where there are more angles than it has
   room for. */
int anneal_stages(const Problem *problem, const Tasks *tasks, const Shares *shares, Line *line, int64_t round, int64_t rounds,
                  double warm, double cooling, double *over)
{
    if (problem->angles > MOST_ANGLES)
        return 1;
    measure_all(problem, tasks, line);
    for (int64_t k = round; k < round + rounds; k++, warm *= cooling) {
        for (int64_t i = 0; i < shares->exchanges; i++)
            exchange(problem, tasks, shares, line, warm);
        for (int64_t i = 0; tasks->singles && i < shares->changes; i++)
            change_stages(problem, tasks, line, shares->width[k % shares->widths], warm);
        for (int64_t i = 0; tasks->singles && i < shares->moves; i++)
            reverse(problem, tasks, line, warm);
        for (int64_t i = 0; i < shares->moves; i++)
            move(problem, tasks, line, warm);
    }
    choose_angles(problem, tasks, line, over);
    return 0;
}
