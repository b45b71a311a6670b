/* Simulated annealing of the order of two arms' stages. Method: `orders/paired/orders.py`. */

#include <math.h>
#include <stdint.h>
#include <string.h>

enum { ARMS = 2, MAX_ANGLES = 256, MAX_STAGES = 16 };

static const int64_t IDLE = -1;
static const double MAX_TIME = 1e6;        /* upper bound of all stage times [s] */
static const double TIME_TOLERANCE = 1e-9; /* least improvement of the total time [s] */

/* Times of stages with `stops` stops at `angles` platform angles [s].

   Rows are previous stops, with row `stops` for the start; columns are stops, with column `stops` for the return to the
   start and the next column for an idle arm. */
typedef struct {
    const float *length[ARMS];     /* times by previous and next angle, (stops + 1, stops + 2, angles, angles) */
    const float *least[ARMS];      /* minima over the angles, (stops + 1, stops + 2) */
    const float *pair_cost;        /* added for two simultaneous stops, (stops + 2, stops + 2, angles); may be null */
    const double *platform_return; /* times of the platform back from each angle, (angles,) */
    int64_t stops, angles, free_start;
} Problem;

/* Tasks and their stops. */
typedef struct {
    const int64_t *begin;      /* first index of each task in `stop`, and the number of stops, (tasks + 1,) */
    const int64_t *stop;       /* stops, task by task */
    const int64_t *task;       /* task of each stop and of the start, (stops + 1,) */
    const int64_t *inner;      /* whether a stop is followed by another one of its task, (stops + 1,) */
    const int64_t *sorted;     /* tasks by their number of stops, (tasks,) */
    const int64_t *same_size;  /* begin and end in `sorted` of the tasks with as many stops, (tasks, 2) */
    const int64_t *neighbours; /* other tasks near each task, (tasks, neighbour_count) */
    int64_t tasks, neighbour_count, singles; /* singles: whether all tasks have one stop */
} Tasks;

/* Order of `count` stages, including start and return, with all that follows from it. */
typedef struct {
    int64_t *stops;       /* stop of each arm, or IDLE, (stages, 2) */
    int64_t *previous;    /* stop of each arm before the stage, (stages, 2) */
    int64_t *next;        /* next stage in which each arm has a stop, (stages, 2) */
    int64_t *angle;       /* platform angles, (stages,) */
    double *cost;         /* times [s], (stages,) */
    double *reversed;     /* times in reversed order [s], (stages,) */
    double *sum;          /* sums of `cost` over the stages before, (stages + 1,) */
    double *reversed_sum; /* sums of `reversed` over the stages before, (stages + 1,) */
    int64_t *idle_sum;    /* number of stages before with an idle arm, (stages + 1,) */
    int64_t *place;       /* stage and arm of each stop, (stops, 2) */
    int64_t *idle;        /* slots 2 stage + arm at which an arm is idle and not within a task */
    int64_t *cut;         /* stages at which a run may begin: both arms have a stop, neither is within a task */
    int64_t *best_stops;  /* stops of the best order, (stages, 2) */
    int64_t count, idle_count, cut_count, best_count;
    double best;      /* total time of the best order [s] */
    double predicted; /* sum of the predicted changes of the total time [s] */
    uint64_t random;  /* state of the generator */
} Order;

/* Settings of the annealing. */
typedef struct {
    int64_t exchanges, permutations, moves; /* trials per round */
    int64_t widths;                         /* number of `width` */
    const int64_t *width;                   /* stages of a permutation, taken in turn by the rounds */
    double far, idle, alone; /* fractions of exchanges with a distant task, with an idle arm and with new stages */
} Settings;

/* Replacement of `old_width` stages from `first` on by `width` new ones. */
typedef struct {
    int64_t first, old_width, width;
    int64_t last;  /* last stage whose time changes */
    int64_t angle; /* of the last new stage */
    int64_t stops[MAX_STAGES][ARMS], previous[MAX_STAGES + 1][ARMS];
    double values[MAX_STAGES + 1][MAX_ANGLES]; /* end time of each stage at each angle */
} Change;

/* Draw 64 random bits (SplitMix64). */
static uint64_t random_bits(Order *order)
{
    uint64_t x = order->random += 0x9e3779b97f4a7c15u;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return x ^ (x >> 31);
}

/* Draw a number from [0, 1). */
static double uniform(Order *order)
{
    return (double)(random_bits(order) >> 11) * 0x1p-53;
}

/* Draw an integer from [0, end). */
static int64_t random_below(Order *order, int64_t end)
{
    return (int64_t)(((random_bits(order) >> 32) * (uint64_t)end) >> 32);
}

/* Draw the largest increase of the total time that is accepted at a temperature [s]. */
static double draw_max_delta(Order *order, double temperature)
{
    return -temperature * log(1.0 - uniform(order));
}

/* Check whether both arms are idle. */
static int is_empty(const int64_t stop[ARMS])
{
    return stop[0] == IDLE && stop[1] == IDLE;
}

/* Look up the times of an arm in a stage, (angles, angles). */
static const float *arm_times(const Problem *problem, int arm, int64_t previous, int64_t stop)
{
    const int64_t column = stop == IDLE ? problem->stops + 1 : stop;
    return problem->length[arm] + (previous * (problem->stops + 2) + column) * problem->angles * problem->angles;
}

/* Compute the least time of a stage over all angles [s]. */
static double least_time(const Problem *problem, const int64_t previous[ARMS], const int64_t stop[ARMS])
{
    double least = 0.0;
    for (int a = 0; a < ARMS; a++)
        if (stop[a] != IDLE && stop[a] != problem->stops) {
            const double arm_least = problem->least[a][previous[a] * (problem->stops + 2) + stop[a]];
            least = arm_least > least ? arm_least : least;
        }
    return least;
}

/* Look up the cost of the pair of stops of a stage [s]. */
static double stage_pair_cost(const Problem *problem, const int64_t stop[ARMS], int64_t angle)
{
    const int64_t columns = problem->stops + 2;
    if (!problem->pair_cost || stop[0] == problem->stops)
        return 0.0;
    const int64_t first = stop[0] == IDLE ? columns - 1 : stop[0], second = stop[1] == IDLE ? columns - 1 : stop[1];
    return problem->pair_cost[(first * columns + second) * problem->angles + angle];
}

/* Compute the times of a stage from the angles [begin, end) to an angle [s]; a return if both stops are the start. */
static void stage_times(const Problem *problem, const int64_t previous[ARMS], const int64_t stop[ARMS], int64_t angle,
                        int64_t begin, int64_t end, double *length)
{
    const int64_t home = problem->stops, f = problem->angles;
    const int is_return = stop[0] == home;
    const float *times[ARMS];
    for (int a = 0; a < ARMS; a++)
        /* An arm that never left the start does not return. */
        times[a] = arm_times(problem, a, previous[a], is_return && previous[a] == home ? IDLE : stop[a]);
    const double pair_cost = stage_pair_cost(problem, stop, angle);
    for (int64_t k = begin; k < end; k++) {
        const float first = times[0][k * f + angle], second = times[1][k * f + angle];
        const double longest = (double)(first > second ? first : second) + pair_cost;
        length[k - begin] = is_return && problem->platform_return[k] > longest ? problem->platform_return[k] : longest;
    }
}

/* Compute the time of a stage between two angles [s]. */
static double stage_time(const Problem *problem, const int64_t previous[ARMS], const int64_t stop[ARMS],
                         int64_t from, int64_t angle)
{
    double length;
    stage_times(problem, previous, stop, angle, from, from + 1, &length);
    return length;
}

/* Compute the end time of a stage at each angle from those of the previous stage at the angles [begin, end). */
static void propagate_stage(const Problem *problem, const int64_t previous[ARMS], const int64_t stop[ARMS],
                            const double *previous_end, int64_t begin, int64_t end, double *restrict end_time)
{
    const int64_t f = problem->angles;
    const float *first = arm_times(problem, 0, previous[0], stop[0]);
    const float *second = arm_times(problem, 1, previous[1], stop[1]);
    for (int64_t g = 0; g < f; g++)
        end_time[g] = INFINITY;
    for (int64_t k = begin; k < end; k++) {
        const double start = previous_end[k];
        if (!(start < INFINITY))
            continue;
        const float *x = first + k * f, *y = second + k * f;
        for (int64_t g = 0; g < f; g++) {
            const double sum = start + (double)(x[g] > y[g] ? x[g] : y[g]);
            end_time[g] = sum < end_time[g] ? sum : end_time[g];
        }
    }
    if (problem->pair_cost)
        for (int64_t g = 0; g < f; g++)
            end_time[g] += stage_pair_cost(problem, stop, g);
}

/* Select the previous angle from which a stage at `angle` ends first, given the end times of the previous stage. */
static int64_t best_previous_angle(const Problem *problem, const int64_t previous[ARMS], const int64_t stop[ARMS],
                                   int64_t angle, const double *previous_end)
{
    const int64_t f = problem->angles;
    const float *first = arm_times(problem, 0, previous[0], stop[0]);
    const float *second = arm_times(problem, 1, previous[1], stop[1]);
    double least = INFINITY;
    int64_t best = 0;
    for (int64_t k = 0; k < f; k++) {
        const float x = first[k * f + angle], y = second[k * f + angle];
        const double sum = previous_end[k] + (double)(x > y ? x : y);
        if (sum < least) {
            least = sum;
            best = k;
        }
    }
    return best;
}

/* Recompute the times of the stages from `begin` to `end`, inclusive. */
static void update_times(const Problem *problem, const Tasks *tasks, Order *order, int64_t begin, int64_t end)
{
    int64_t *stops = order->stops, *previous = order->previous, *angle = order->angle;
    const int64_t n = order->count;
    for (int64_t k = begin; k < n; k++)
        for (int a = 0; a < ARMS; a++)
            previous[ARMS * k + a] =
                stops[ARMS * (k - 1) + a] == IDLE ? previous[ARMS * (k - 1) + a] : stops[ARMS * (k - 1) + a];
    for (int64_t k = begin; k <= end; k++)
        order->cost[k] = stage_time(problem, previous + ARMS * k, stops + ARMS * k, angle[k - 1], angle[k]);
    for (int64_t k = begin - 1; tasks->singles && k <= end; k++) {
        const int64_t *row = stops + ARMS * k;
        const int is_reversible =
            k > 0 && k < n - 2 && row[0] != IDLE && row[1] != IDLE && row[2] != IDLE && row[3] != IDLE;
        const double reversed = is_reversible ? stage_time(problem, row + ARMS, row, angle[k + 1], angle[k]) : 0.0;
        order->reversed[k] = reversed < MAX_TIME ? reversed : MAX_TIME;
    }
}

/* Recompute all other values that depend on stops and angles, and update the best order. */
static void update_rest(const Tasks *tasks, Order *order)
{
    const int64_t n = order->count;
    order->idle_count = order->cut_count = 0;
    for (int64_t k = 0; k < n; k++) {
        const int64_t *row = order->stops + ARMS * k, *previous = order->previous + ARMS * k;
        const int has_idle = row[0] == IDLE || row[1] == IDLE;
        order->sum[k + 1] = order->sum[k] + order->cost[k];
        order->reversed_sum[k + 1] = order->reversed_sum[k] + order->reversed[k];
        order->idle_sum[k + 1] = order->idle_sum[k] + has_idle;
        if (k > 0 && !has_idle && !tasks->inner[previous[0]] && !tasks->inner[previous[1]])
            order->cut[order->cut_count++] = k;
        for (int a = 0; a < ARMS && k > 0 && k < n - 1; a++)
            if (row[a] != IDLE) {
                order->place[ARMS * row[a]] = k;
                order->place[ARMS * row[a] + 1] = a;
            } else if (!tasks->inner[previous[a]])
                order->idle[order->idle_count++] = ARMS * k + a;
    }
    for (int64_t k = n - 1; k >= 0; k--)
        for (int a = 0; a < ARMS; a++)
            order->next[ARMS * k + a] = order->stops[ARMS * k + a] == IDLE ? order->next[ARMS * (k + 1) + a] : k;
    if (order->sum[n] < order->best - TIME_TOLERANCE) {
        order->best = order->sum[n];
        order->best_count = n;
        memcpy(order->best_stops, order->stops, (size_t)(ARMS * n) * sizeof *order->stops);
    }
}

/* Remove empty stages and recompute all values. */
static void update_all(const Problem *problem, const Tasks *tasks, Order *order)
{
    int64_t n = 0;
    for (int64_t k = 0; k < order->count; k++)
        if (!is_empty(order->stops + ARMS * k)) {
            memmove(order->stops + ARMS * n, order->stops + ARMS * k, ARMS * sizeof *order->stops);
            order->angle[n++] = order->angle[k];
        }
    order->count = n;
    update_times(problem, tasks, order, 1, n - 1);
    update_rest(tasks, order);
}

/* Choose the best angles for the stages by dynamic programming. end_time: buffer, (stages, angles). */
static void choose_angles(const Problem *problem, const Tasks *tasks, Order *order, double *end_time)
{
    const int64_t f = problem->angles, n = order->count;
    double total[MAX_ANGLES];
    for (int64_t g = 0; g < f; g++)
        end_time[g] = g == 0 || problem->free_start ? 0.0 : INFINITY;
    for (int64_t k = 1; k < n - 1; k++)
        propagate_stage(problem, order->previous + ARMS * k, order->stops + ARMS * k, end_time + (k - 1) * f, 0, f,
                        end_time + k * f);
    stage_times(problem, order->previous + ARMS * (n - 1), order->stops + ARMS * (n - 1), 0, 0, f, total);
    int64_t best = 0;
    for (int64_t g = 0; g < f; g++) {
        total[g] += end_time[(n - 2) * f + g];
        best = total[g] < total[best] ? g : best;
    }
    for (int64_t k = n - 2; k > 0; k--) {
        order->angle[k] = best;
        best = best_previous_angle(problem, order->previous + ARMS * k, order->stops + ARMS * k, best,
                                   end_time + (k - 1) * f);
    }
    order->angle[0] = best;
    update_all(problem, tasks, order);
}

/* Find the next stage of an arm that is idle right after a change, and the previous stops of that stage.

   Returns 0 if the arm is not idle there, or if its previous stop does not change. */
static int64_t next_stage_after(const Order *order, const Change *change, int arm, int64_t previous[ARMS])
{
    const int64_t end = change->first + change->old_width;
    if (order->stops[ARMS * end + arm] != IDLE ||
        change->previous[change->width][arm] == order->previous[ARMS * end + arm])
        return 0;
    const int64_t k = order->next[ARMS * end + arm];
    previous[arm] = change->previous[change->width][arm];
    previous[1 - arm] = order->previous[ARMS * k + 1 - arm];
    return k;
}

/* Prepare a change with given stages and stops; return a lower bound of its change of the total time [s]. */
static double prepare_change(const Problem *problem, const Order *order, Change *change)
{
    const int64_t begin = change->first, end = begin + change->old_width;
    double bound = order->sum[begin] - order->sum[end + 1];
    for (int a = 0; a < ARMS; a++)
        change->previous[0][a] = order->previous[ARMS * begin + a];
    for (int64_t i = 0; i < change->width; i++) {
        bound += least_time(problem, change->previous[i], change->stops[i]);
        for (int a = 0; a < ARMS; a++)
            change->previous[i + 1][a] = change->stops[i][a] == IDLE ? change->previous[i][a] : change->stops[i][a];
    }
    bound += least_time(problem, change->previous[change->width], order->stops + ARMS * end);
    change->last = end;
    for (int a = 0; a < ARMS; a++) {
        int64_t previous[ARMS];
        const int64_t k = next_stage_after(order, change, a, previous);
        if (k) {
            bound += least_time(problem, previous, order->stops + ARMS * k) - order->cost[k];
            change->last = k;
        }
    }
    return bound;
}

/* Compute the change of the total time by a prepared change [s], infinite if it is impossible.

   The new stages take their best angles; those of the stages before and after remain. */
static double evaluate_change(const Problem *problem, const Order *order, Change *change)
{
    const int64_t f = problem->angles, begin = change->first, end = begin + change->old_width, width = change->width;
    int64_t first_angle = order->angle[begin - 1], end_angle = first_angle + 1;
    double total[MAX_ANGLES];
    for (int64_t g = 0; g < f; g++)
        change->values[0][g] = INFINITY;
    change->values[0][first_angle] = 0.0;
    for (int64_t i = 0; i < width; i++)
        if (is_empty(change->stops[i])) {
            /* The platform does not turn in an empty stage. */
            memcpy(change->values[i + 1], change->values[i], (size_t)f * sizeof(double));
        } else {
            propagate_stage(problem, change->previous[i], change->stops[i], change->values[i], first_angle, end_angle,
                            change->values[i + 1]);
            first_angle = 0;
            end_angle = f;
        }
    stage_times(problem, change->previous[width], order->stops + ARMS * end, order->angle[end], first_angle, end_angle,
                total + first_angle);
    change->angle = first_angle;
    for (int64_t g = first_angle; g < end_angle; g++) {
        total[g] += change->values[width][g];
        change->angle = total[g] < total[change->angle] ? g : change->angle;
    }
    double delta = total[change->angle] - (order->sum[end + 1] - order->sum[begin]);
    for (int a = 0; a < ARMS; a++) {
        int64_t previous[ARMS];
        const int64_t k = next_stage_after(order, change, a, previous);
        if (k)
            delta += stage_time(problem, previous, order->stops + ARMS * k, order->angle[k - 1], order->angle[k]) -
                     order->cost[k];
    }
    return delta;
}

/* Apply an evaluated change without recomputing values; return whether the indices of other stages change. */
static int apply_change(const Problem *problem, Order *order, const Change *change)
{
    const int64_t growth = change->width - change->old_width, end = change->first + change->old_width;
    const int64_t following = order->count - end;
    int renumbered = growth != 0;
    if (renumbered) {
        memmove(order->stops + ARMS * (end + growth), order->stops + ARMS * end,
                (size_t)(ARMS * following) * sizeof *order->stops);
        memmove(order->angle + end + growth, order->angle + end, (size_t)following * sizeof *order->angle);
        order->count += growth;
    }
    int64_t angle = change->angle;
    for (int64_t i = change->width - 1; i >= 0; i--) {
        const int64_t *stop = change->stops[i], k = change->first + i;
        memcpy(order->stops + ARMS * k, stop, ARMS * sizeof *stop);
        order->angle[k] = angle;
        if (is_empty(stop))
            renumbered = 1;
        else
            angle = best_previous_angle(problem, change->previous[i], stop, angle, change->values[i]);
    }
    return renumbered;
}

/* Set up a change that replaces the stops of an arm in some stages; a null `stop` makes it idle. */
static void set_stops(const Order *order, Change *change, int64_t first, int64_t arm, const int64_t *stop,
                      int64_t width)
{
    change->first = first;
    change->old_width = change->width = width;
    memcpy(change->stops, order->stops + ARMS * first, (size_t)(ARMS * width) * sizeof *order->stops);
    for (int64_t i = 0; i < width; i++)
        change->stops[i][arm] = stop ? stop[i] : IDLE;
}

/* Check whether the stops of a task are in consecutive stages. */
static int is_consecutive(const Order *order, const int64_t *stop, int64_t width)
{
    for (int64_t i = 1; i < width; i++)
        if (order->place[ARMS * stop[i]] != order->place[ARMS * stop[0]] + i)
            return 0;
    return 1;
}

/* Draw a task with as many stops to exchange with `task`: mostly one near the previous or next stop of its arm. */
static int64_t draw_partner(const Tasks *tasks, const Settings *settings, Order *order, int64_t task, int64_t home)
{
    const int64_t *stop = tasks->stop + tasks->begin[task], width = tasks->begin[task + 1] - tasks->begin[task];
    const int64_t *place = order->place + ARMS * stop[0], *same_size = tasks->same_size + 2 * task;
    const int64_t end = place[0] + width < order->count ? place[0] + width : order->count - 1;
    const int64_t *beside = random_bits(order) >> 63 ? order->previous + ARMS * place[0] : order->stops + ARMS * end;
    if (beside[place[1]] != IDLE && beside[place[1]] != home && uniform(order) >= settings->far) {
        const int64_t first = tasks->task[beside[place[1]]] * tasks->neighbour_count;
        const int64_t partner = tasks->neighbours[first + random_below(order, tasks->neighbour_count)];
        if (tasks->begin[partner + 1] - tasks->begin[partner] == width)
            return partner;
    }
    return tasks->sorted[same_size[0] + random_below(order, same_size[1] - same_size[0])];
}

/* Try to exchange two tasks, or to move a task to an idle arm or to new stages. */
static void try_exchange(const Problem *problem, const Tasks *tasks, const Settings *settings, Order *order,
                         double temperature)
{
    Change both[2], *first = both, *second = both + 1;
    const int64_t task = random_below(order, tasks->tasks), width = tasks->begin[task + 1] - tasks->begin[task];
    const int64_t *stop = tasks->stop + tasks->begin[task], *place = order->place + ARMS * stop[0];
    if (width > MAX_STAGES || !is_consecutive(order, stop, width))
        return;
    const double draw = uniform(order);
    if (draw < settings->alone) {
        const int64_t arm = random_below(order, ARMS), k = 1 + random_below(order, order->count - 1);
        if (tasks->inner[order->previous[ARMS * k + arm]])
            return;
        set_stops(order, first, place[0], place[1], 0, width);
        second->first = k;
        second->old_width = 0;
        second->width = width;
        for (int64_t i = 0; i < width; i++) {
            second->stops[i][arm] = stop[i];
            second->stops[i][1 - arm] = IDLE;
        }
    } else if (width == 1 && order->idle_count && draw < settings->alone + settings->idle) {
        const int64_t slot = order->idle[random_below(order, order->idle_count)];
        set_stops(order, first, place[0], place[1], 0, 1);
        set_stops(order, second, slot / ARMS, slot % ARMS, stop, 1);
    } else {
        const int64_t partner = draw_partner(tasks, settings, order, task, problem->stops);
        const int64_t *partner_stops = tasks->stop + tasks->begin[partner];
        const int64_t *partner_place = order->place + ARMS * partner_stops[0];
        if (!is_consecutive(order, partner_stops, width))
            return;
        set_stops(order, first, place[0], place[1], partner_stops, width);
        set_stops(order, second, partner_place[0], partner_place[1], stop, width);
    }
    if (first->first > second->first) {
        first = both + 1;
        second = both;
    }
    if (first->first + first->old_width >= second->first)
        return;
    const double max_delta = draw_max_delta(order, temperature), bound = prepare_change(problem, order, first);
    if (first->last >= second->first || bound + prepare_change(problem, order, second) >= max_delta)
        return;
    const double delta = evaluate_change(problem, order, first) + evaluate_change(problem, order, second);
    if (!(delta < max_delta))
        return;
    order->predicted += delta;
    /* The later change first, so that the stages of the earlier one keep their indices. */
    const int renumbered = apply_change(problem, order, second);
    if (apply_change(problem, order, first) || renumbered) {
        update_all(problem, tasks, order);
        return;
    }
    update_times(problem, tasks, order, first->first, first->last);
    update_times(problem, tasks, order, second->first, second->last);
    update_rest(tasks, order);
}

/* Try to exchange, shift or shuffle the stops of consecutive stages; only for tasks of one stop each. */
static void try_permutation(const Problem *problem, const Tasks *tasks, Order *order, int64_t width, double temperature)
{
    Change change;
    int64_t(*stop)[ARMS] = change.stops;
    if (width > order->count - 2 || width > MAX_STAGES)
        return;
    change.first = 1 + random_below(order, order->count - 1 - width);
    change.old_width = change.width = width;
    const int64_t *stops = order->stops + ARMS * change.first;
    const int64_t kind = width == 1 ? 0 : random_below(order, 6), shift = kind == 4 ? 1 : width - 1;
    for (int64_t i = 0; i < width; i++)
        for (int a = 0; a < ARMS; a++) {
            /* The arms exchange their stops (0), or both (1, 4) or one of them (2, 3) shift by a stage. */
            const int shifts = kind == 1 || kind == 4 || kind == 2 + a;
            const int64_t from = shifts ? (i + shift) % width : i;
            stop[i][a] = stops[ARMS * from + (kind == 0 ? 1 - a : a)];
        }
    /* Shuffle all stops of the stages (5). */
    for (int64_t i = kind == 5 ? ARMS * width - 1 : 0; i > 0; i--) {
        const int64_t k = random_below(order, i + 1), swapped = stop[i / ARMS][i % ARMS];
        stop[i / ARMS][i % ARMS] = stop[k / ARMS][k % ARMS];
        stop[k / ARMS][k % ARMS] = swapped;
    }
    const double max_delta = draw_max_delta(order, temperature);
    if (prepare_change(problem, order, &change) >= max_delta)
        return;
    const double delta = evaluate_change(problem, order, &change);
    if (!(delta < max_delta))
        return;
    order->predicted += delta;
    if (apply_change(problem, order, &change))
        update_all(problem, tasks, order);
    else {
        update_times(problem, tasks, order, change.first, change.last);
        update_rest(tasks, order);
    }
}

/* Reverse the order of the stages [begin, end) with their angles, without recomputing values. */
static void reverse_stages(Order *order, int64_t begin, int64_t end)
{
    for (end--; begin < end; begin++, end--) {
        int64_t *first = order->stops + ARMS * begin, *second = order->stops + ARMS * end;
        for (int a = 0; a < ARMS; a++) {
            const int64_t stop = first[a];
            first[a] = second[a];
            second[a] = stop;
        }
        const int64_t angle = order->angle[begin];
        order->angle[begin] = order->angle[end];
        order->angle[end] = angle;
    }
}

/* Try to reverse a run of stages without idle arms; only for tasks of one stop each. */
static void try_reversal(const Problem *problem, const Tasks *tasks, Order *order, double temperature)
{
    const int64_t n = order->count - 2, *stops = order->stops, *angle = order->angle;
    const int64_t begin = 1 + random_below(order, n), reach = begin + 2 + random_below(order, n);
    const int64_t end = reach < n + 1 ? reach : n + 1;
    if (end - begin < 2 || order->idle_sum[end + 1] != order->idle_sum[begin - 1])
        return;
    const double max_delta = draw_max_delta(order, temperature);
    double delta =
        order->reversed_sum[end - 1] - order->reversed_sum[begin] - (order->sum[end + 1] - order->sum[begin]);
    const int64_t *first = stops + ARMS * (end - 1), *last = stops + ARMS * begin;
    if (delta + least_time(problem, stops + ARMS * (begin - 1), first) +
            least_time(problem, last, stops + ARMS * end) >=
        max_delta)
        return;
    delta += stage_time(problem, stops + ARMS * (begin - 1), first, angle[begin - 1], angle[end - 1]);
    delta += stage_time(problem, last, stops + ARMS * end, angle[begin], angle[end]);
    if (!(delta < max_delta))
        return;
    order->predicted += delta;
    reverse_stages(order, begin, end);
    update_times(problem, tasks, order, begin, end);
    update_rest(tasks, order);
}

/* Check whether a run of stages may begin at a stage. */
static int is_cut(const Tasks *tasks, const Order *order, int64_t k)
{
    const int64_t *row = order->stops + ARMS * k, *previous = order->previous + ARMS * k;
    return row[0] != IDLE && row[1] != IDLE && !tasks->inner[previous[0]] && !tasks->inner[previous[1]];
}

/* Try to exchange two consecutive runs of stages, [i, j) and [j, p), with their angles. */
static void try_move(const Problem *problem, const Tasks *tasks, Order *order, double temperature)
{
    if (order->cut_count < 3)
        return;
    const int64_t x = order->cut[random_below(order, order->cut_count)];
    const int64_t y = order->cut[random_below(order, order->cut_count)];
    const int64_t i = x < y ? x : y, p = x < y ? y : x;
    const int64_t *stops = order->stops, *previous = order->previous, *angle = order->angle;
    /* Half of the first runs have one to three stages. */
    const int64_t j =
        random_bits(order) >> 63 ? i + 1 + random_below(order, 3) : order->cut[random_below(order, order->cut_count)];
    if (j <= i || j >= p || !is_cut(tasks, order, j))
        return;
    const double max_delta = draw_max_delta(order, temperature);
    double delta = -order->cost[i] - order->cost[j] - order->cost[p];
    if (delta + least_time(problem, previous + ARMS * i, stops + ARMS * j) +
            least_time(problem, previous + ARMS * p, stops + ARMS * i) +
            least_time(problem, previous + ARMS * j, stops + ARMS * p) >=
        max_delta)
        return;
    delta += stage_time(problem, previous + ARMS * i, stops + ARMS * j, angle[i - 1], angle[j]);
    delta += stage_time(problem, previous + ARMS * p, stops + ARMS * i, angle[p - 1], angle[i]);
    delta += stage_time(problem, previous + ARMS * j, stops + ARMS * p, angle[j - 1], angle[p]);
    if (!(delta < max_delta))
        return;
    order->predicted += delta;
    reverse_stages(order, i, j);
    reverse_stages(order, j, p);
    reverse_stages(order, i, p);
    update_times(problem, tasks, order, i, p);
    update_rest(tasks, order);
}

/* Anneal an order for some rounds from `round` on, then choose all angles again.

   temperature: of the first round [s]; multiplied by `cooling` after each round. end_time: buffer, (stages, angles).
   Returns 0, or 1 if there are more than MAX_ANGLES angles. */
int anneal_stages(const Problem *problem, const Tasks *tasks, const Settings *settings, Order *order, int64_t round,
                  int64_t rounds, double temperature, double cooling, double *end_time)
{
    if (problem->angles > MAX_ANGLES)
        return 1;
    update_all(problem, tasks, order);
    for (int64_t k = round; k < round + rounds; k++, temperature *= cooling) {
        for (int64_t i = 0; i < settings->exchanges; i++)
            try_exchange(problem, tasks, settings, order, temperature);
        for (int64_t i = 0; tasks->singles && i < settings->permutations; i++)
            try_permutation(problem, tasks, order, settings->width[k % settings->widths], temperature);
        for (int64_t i = 0; tasks->singles && i < settings->moves; i++)
            try_reversal(problem, tasks, order, temperature);
        for (int64_t i = 0; i < settings->moves; i++)
            try_move(problem, tasks, order, temperature);
    }
    choose_angles(problem, tasks, order, end_time);
    return 0;
}
