/* Least rest-to-rest times between boxes of joint coordinates from tables, for lower bounds and potentials.

   Coordinates are table steps (int16), coordinate first: x[c * count + i]. Joints with proportional limits form a class
   with one table; the time of a transfer is the maximum over the classes, each at the largest gap of its joints. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

/* Tables of rest-to-rest times. */
typedef struct {
    const float *table;    /* times by number of steps [s], (classes, steps) */
    const int32_t *column; /* coordinates of all classes, in order of the classes */
    const int32_t *end;    /* end of each class in `column`, (classes,) */
    int32_t classes, steps;
} Laws;

/* Boxes of coordinates. */
typedef struct {
    const int16_t *low, *high; /* (coordinates, count) */
    int64_t count;
} Boxes;

/* Cells at which transfers begin or end, in runs. */
typedef struct {
    Boxes cells;
    const int64_t *group; /* platform cell of each cell, ascending, (count,) */
    Boxes runs;           /* boxes around consecutive cells of one group */
    const int64_t *first; /* first cell of each run, and the number of cells, (runs + 1,) */
} CellRuns;

enum { TILE = 512, BLOCK = 32 }; /* boxes processed together, and cells with a common bound */

/* Compute the largest gaps of the joints of class k from box i to `count` boxes from `begin` on, at most TILE. */
static void compute_gaps(const Laws *laws, int32_t k, Boxes from, int64_t i, Boxes to, int64_t begin, int64_t count,
                         int16_t *gap)
{
    for (int64_t j = 0; j < count; j++)
        gap[j] = 0;
    for (int32_t c = k ? laws->end[k - 1] : 0; c < laws->end[k]; c++) {
        const int64_t column = laws->column[c];
        const int16_t low = from.low[column * from.count + i], high = from.high[column * from.count + i];
        const int16_t *goal_low = to.low + column * to.count + begin;
        const int16_t *goal_high = to.high + column * to.count + begin;
        if (low == high && goal_low == goal_high) {
            /* Between points the gap is symmetric. */
            for (int64_t j = 0; j < count; j++) {
                const int16_t over = (int16_t)(goal_low[j] - low), under = (int16_t)-over;
                const int16_t larger = over > under ? over : under;
                gap[j] = gap[j] > larger ? gap[j] : larger;
            }
            continue;
        }
        for (int64_t j = 0; j < count; j++) {
            const int16_t over = (int16_t)(goal_low[j] - high), under = (int16_t)(low - goal_high[j]);
            const int16_t larger = over > under ? over : under;
            gap[j] = gap[j] > larger ? gap[j] : larger;
        }
    }
}

/* Compute the times from box i to `count` boxes from `begin` on, at most TILE. */
static void compute_row(const Laws *laws, Boxes from, int64_t i, Boxes to, int64_t begin, int64_t count, float *time)
{
    int16_t gap[TILE];
    for (int32_t k = 0; k < laws->classes; k++) {
        compute_gaps(laws, k, from, i, to, begin, count, gap);
        const float *table = laws->table + (int64_t)k * laws->steps;
        for (int64_t j = 0; j < count; j++) {
            const float time_k = table[gap[j]];
            time[j] = k == 0 || time_k > time[j] ? time_k : time[j];
        }
    }
}

/* Compute the times between all pairs of boxes, (from->count, to->count). */
void gap_times(const Laws *laws, const Boxes *from, const Boxes *to, float *time)
{
    for (int64_t i = 0; i < from->count; i++)
        for (int64_t j = 0; j < to->count; j += TILE) {
            const int64_t count = to->count - j < TILE ? to->count - j : TILE;
            compute_row(laws, *from, i, *to, j, count, time + i * to->count + j);
        }
}

/* Minima computed in parallel, so that the compiler vectorises them. */
enum { LANES = 8 };

/* Compute the minimum of value[begin:end]. */
static float minimum(const float *value, int64_t begin, int64_t end)
{
    float least[LANES];
    int64_t j = begin;
    for (int lane = 0; lane < LANES; lane++)
        least[lane] = INFINITY;
    for (; j + LANES <= end; j += LANES)
        for (int lane = 0; lane < LANES; lane++)
            least[lane] = value[j + lane] < least[lane] ? value[j + lane] : least[lane];
    for (; j < end; j++)
        least[0] = value[j] < least[0] ? value[j] : least[0];
    for (int lane = 1; lane < LANES; lane++)
        least[0] = least[lane] < least[0] ? least[lane] : least[0];
    return least[0];
}

/* Compute the times between all pairs of boxes including work, and lower the least time of each pair of groups to them.

   work: time added at each box of `to`, (to->count,). group: of each box of `from`, (from->count,).
   first: first box of each group of `to`, and the number of boxes, (groups + 1,).
   time: (from->count, to->count). least: infinite at first, (groups, groups). */
void work_times(const Laws *laws, const Boxes *from, const Boxes *to, const float *work, const int64_t *group,
                const int64_t *first, int64_t groups, float *time, float *least)
{
    gap_times(laws, from, to, time);
    for (int64_t i = 0; i < from->count; i++) {
        float *row = time + i * to->count, *best = least + group[i] * groups;
        for (int64_t j = 0; j < to->count; j++)
            row[j] += work[j];
        for (int64_t g = 0; g < groups; g++) {
            const float group_least = minimum(row, first[g], first[g + 1]);
            best[g] = group_least < best[g] ? group_least : best[g];
        }
    }
}

/* Minimise max(time, floor) + remaining over the columns of each row.

   time: (rows, count). group: of the rows, those of one group consecutive, (rows,). column: groups of the columns,
   (count,). floor: of each pair of groups, (groups, groups). remaining: of the columns, (count,). least: (rows,).
   Returns 0, or 1 if out of memory. */
int least_through(const float *time, int64_t rows, int64_t count, const int64_t *group, const int64_t *column,
                  int64_t groups, const float *floor, const float *remaining, float *least)
{
    float *floors = malloc(sizeof(float) * (size_t)(2 * count + 1));
    if (!floors)
        return 1;
    float *totals = floors + count;
    for (int64_t i = 0; i < rows; i++) {
        /* Rows of one group are consecutive. */
        if (!i || group[i] != group[i - 1])
            for (int64_t j = 0; j < count; j++)
                floors[j] = floor[group[i] * groups + column[j]];
        const float *row = time + i * count;
        for (int64_t j = 0; j < count; j++)
            totals[j] = (row[j] > floors[j] ? row[j] : floors[j]) + remaining[j];
        least[i] = minimum(totals, 0, count);
    }
    free(floors);
    return 0;
}

/* Cells at one end of a stop's lines. */
typedef struct {
    Boxes cells;
    const int64_t *first; /* first cell of each group, and the number of cells, (groups + 1,) */
    const float *line;    /* least time of the line at each cell [s] */
    const int16_t *travel; /* largest travel of the joints in this time [steps], (classes, count) */
} LineEnds;

/* Run or block of cells with the lower bound of its times. */
typedef struct {
    float bound;
    int32_t index;
} Candidate;

/* Order candidates by bound, then by index. */
static int by_bound(const void *first, const void *second)
{
    const Candidate *a = first, *b = second;
    if (a->bound != b->bound)
        return a->bound < b->bound ? -1 : 1;
    return a->index - b->index;
}

/* Compute the least times of both lines from approach cell i to `count` retract cells from `begin` on, at most BLOCK.

   Joints are at rest at the target and travel from cell to cell on both lines together. Travel grows ever faster with
   time, so that the time beyond both least times is best spent on the longer line.
   retracting: least times of the retracts with the delay of what follows [s], (retract->cells.count,). */
static void compute_line_times(const Laws *laws, const LineEnds *approach, int64_t i, const LineEnds *retract,
                               const float *retracting, int64_t begin, int64_t count, float *time)
{
    int16_t gap[BLOCK];
    const float line = approach->line[i];
    for (int64_t j = 0; j < count; j++)
        time[j] = line + retracting[begin + j];
    for (int32_t k = 0; k < laws->classes; k++) {
        compute_gaps(laws, k, approach->cells, i, retract->cells, begin, count, gap);
        const float *table = laws->table + (int64_t)k * laws->steps;
        const int16_t travel = approach->travel[k * approach->cells.count + i];
        const int16_t *travels = retract->travel + k * retract->cells.count + begin;
        for (int64_t j = 0; j < count; j++) {
            const float other = retract->line[begin + j], shorter = line < other ? line : other;
            const int16_t least = travel < travels[j] ? travel : travels[j];
            const float sum = shorter + table[gap[j] > least ? gap[j] - least : 0];
            time[j] = sum > time[j] ? sum : time[j];
        }
    }
}

/* Minimise both lines + remaining over the retract cells in the group of each approach cell.

   retracting: see `compute_line_times`. remaining: of each retract cell, (retract->cells.count,). least: infinite for
   groups without retract cells, (approach->cells.count,). Blocks of a group are searched in order of the bounds from their lines and remaining times.
   Returns 0, or 1 if out of memory. */
int least_work(const Laws *laws, const LineEnds *approach, const LineEnds *retract, int64_t groups,
               const float *retracting, const float *remaining, float *least)
{
    Candidate *candidates = malloc(sizeof(Candidate) * (size_t)(retract->cells.count / BLOCK + 1));
    float time[BLOCK];
    if (!candidates)
        return 1;
    for (int64_t g = 0; g < groups; g++) {
        const int64_t begin = retract->first[g], end = retract->first[g + 1];
        const int64_t blocks = (end - begin + BLOCK - 1) / BLOCK;
        for (int64_t b = 0; b < blocks; b++) {
            const int64_t j = begin + b * BLOCK, block_end = j + BLOCK < end ? j + BLOCK : end;
            const float bound = minimum(retracting, j, block_end) + minimum(remaining, j, block_end);
            candidates[b] = (Candidate){bound, (int32_t)b};
        }
        qsort(candidates, (size_t)blocks, sizeof(Candidate), by_bound);
        for (int64_t i = approach->first[g]; i < approach->first[g + 1]; i++) {
            const float line = approach->line[i];
            float best = INFINITY;
            /* A relative margin of 1e-6 covers the rounding of sums in a different order. */
            for (int64_t b = 0; b < blocks && line + candidates[b].bound < best * (1.0F + 1e-6F); b++) {
                const int64_t j = begin + candidates[b].index * BLOCK, count = end - j < BLOCK ? end - j : BLOCK;
                compute_line_times(laws, approach, i, retract, retracting, j, count, time);
                for (int64_t k = 0; k < count; k++) {
                    const float total = time[k] + remaining[j + k];
                    best = total < best ? total : best;
                }
            }
            least[i] = best;
        }
    }
    free(candidates);
    return 0;
}

/* Chains of joints from a target over retract, transfer and approach to the next target; method: `model/motion/rest_to_rest.py`.

   Least displacements on lines are towards their targets [steps]: rises, then falls; -1 if unknown. */
typedef struct {
    const int16_t *before;  /* of the retracts, (2, coordinates, cells of `from`); NULL for transfers from any motion */
    const int16_t *after;   /* of the approaches, (2, coordinates, cells of `to`) */
    const float *retract;   /* least times of the retracts [s], (cells of `from`,) */
    const float *approach;  /* least times of the approaches [s], (cells of `to`,) */
    const float *onward;    /* least time from the target on for each approach [s], (cells of `to`,) */
    const float *speed[3];  /* greatest shares of full speed at the ends of the fastest retracts, (laws, cells of
                               `from`), and approaches, (laws, cells of `to`), and over (laws, runs of `to`) */
    const float *table;     /* times [s] by distance and kind of motion, (laws, 5, entries) */
    const float *rate;      /* acceleration limit per speed limit of each law [1/s], (laws,) */
    const int32_t *law;     /* of each coordinate, -1 for those that do not count, (coordinates,) */
    double step;            /* time of a table step at full speed [s] */
    int64_t laws, coordinates, entries;
    float late[2];          /* displacements hold for retracts and approaches that take less beyond the least [s] */
} Chains;

/* Motions of a joint: between rest, a turn (speed zero with any acceleration), and any motion. */
enum { REST_TO_TURN, REST_TO_REST, REST_TO_ANY, TURN_TO_ANY, TURN_TO_TURN, MOTIONS };
/* Table steps of transfer times per entry of the chains' tables. */
enum { STEPS_PER_ENTRY = 4 };

/* Least times of the chains from one cell to another [s]: from target to approach, from retract to target, and from
   target to target; 0 for none. */
typedef struct {
    float to_approach, from_retract, whole;
} ChainTimes;

/* Raise the times of chains by one joint that first rises, or first falls if the arguments are mirrored.

   out: least displacement on the retract, away from the target, or -1. rise, fall: on the approach, or -1.
   least, most: displacements of the transfer. */
static inline void raise_by_joint(const Chains *chains, const float *table, int out, int rise, int fall, int least,
                                  int most, ChainTimes *times)
{
    const int64_t last = chains->entries - 1;
    const int up = least > 0 ? least : 0, down = most < 0 ? -most : 0;
#define TIME(kind, distance)                                                                                          \
    table[(kind) * chains->entries + ((distance) / STEPS_PER_ENTRY < last ? (distance) / STEPS_PER_ENTRY : last)]
    float to_approach = 0.0F, from_retract = 0.0F, whole = 0.0F;
    if (out >= 0) {
        to_approach = down ? TIME(REST_TO_TURN, out) + TIME(TURN_TO_ANY, down) : up ? TIME(REST_TO_ANY, out + up) : 0.0F;
        if (fall >= 0)
            whole = TIME(REST_TO_TURN, out + up) + TIME(REST_TO_TURN, fall + down);
        const int net = rise >= 0 ? out + rise + least : 0;
        if (rise >= 0 && down)
            whole = fmaxf(whole, TIME(REST_TO_TURN, out) + TIME(TURN_TO_TURN, down) + TIME(REST_TO_TURN, rise));
        else if (net > 0)
            whole = fmaxf(whole, TIME(REST_TO_REST, net));
    }
    if (up && fall >= 0)
        from_retract = TIME(TURN_TO_ANY, up) + TIME(REST_TO_TURN, fall);
    if (up && rise >= 0)
        from_retract = fmaxf(from_retract, TIME(REST_TO_ANY, up + rise));
    times->to_approach = fmaxf(times->to_approach, to_approach);
    times->from_retract = fmaxf(times->from_retract, from_retract);
    times->whole = fmaxf(times->whole, whole);
#undef TIME
}

/* Compute the least time of a joint for a distance between shares of full speed that it may not exceed [s].

   distance: time at full speed [s]. rate: acceleration limit per speed limit [1/s]. */
static inline float time_between(float distance, float rate, float begin, float end)
{
    const float low = begin < end ? begin : end, high = begin < end ? end : begin;
    const float squares = 0.5F * (low * low + high * high);
    /* Roots that set no error number are vectorised. */
    const float from_low = __builtin_elementwise_sqrt(low * low + 2.0F * rate * distance);
    const float peak = __builtin_elementwise_sqrt(rate * distance + squares);
    const float top = peak < 1.0F ? peak : 1.0F;
    const float cruise = distance - (top * top - squares) / rate;
    const float whole = (2.0F * top - low - high) / rate + (peak < 1.0F || cruise < 0.0F ? 0.0F : cruise);
    return from_low < high ? (from_low - low) / rate : whole;
}

/* Raise the totals of transfers from cell i to `count` cells from `begin` on by the speeds of joints at the lines' ends.

   Cells may be runs. leaving, arriving: greatest shares of full speed, (laws, cells); NULL after any motion. arrival:
   time added at each cell of `to`. total: after the motion to `from`. plain: after any motion. */
static void raise_by_speeds(const Laws *laws, const Chains *chains, const float *leaving, const float *arriving,
                            Boxes from, int64_t i, Boxes to, int64_t begin, int64_t count, const float *arrival,
                            float *total, float *plain)
{
    float any[TILE], own[TILE];
    int16_t gap[TILE];
    for (int64_t j = 0; j < count; j++)
        any[j] = own[j] = 0.0F;
    for (int32_t law = 0; law < chains->laws; law++) {
        /* Of the joints with one law, that with the largest gap is the slowest. */
        for (int64_t j = 0; j < count; j++)
            gap[j] = 0;
        for (int32_t c = 0; c < laws->end[laws->classes - 1]; c++) {
            const int64_t column = laws->column[c];
            if (chains->law[column] != law)
                continue;
            const int16_t low = from.low[column * from.count + i], high = from.high[column * from.count + i];
            const int16_t *goal_low = to.low + column * to.count + begin;
            const int16_t *goal_high = to.high + column * to.count + begin;
            for (int64_t j = 0; j < count; j++) {
                const int16_t over = (int16_t)(goal_low[j] - high), under = (int16_t)(low - goal_high[j]);
                const int16_t larger = over > under ? over : under;
                gap[j] = gap[j] > larger ? gap[j] : larger;
            }
        }
        const float rate = chains->rate[law], step = (float)chains->step;
        const float start = leaving ? leaving[law * from.count + i] : 1.0F;
        const float *end = arriving + law * to.count + begin;
        for (int64_t j = 0; j < count; j++) {
            const float after_any = time_between(step * (float)gap[j], rate, 1.0F, end[j]);
            any[j] = after_any > any[j] ? after_any : any[j];
        }
        for (int64_t j = 0; leaving && j < count; j++) {
            const float after_start = time_between(step * (float)gap[j], rate, start, end[j]);
            own[j] = after_start > own[j] ? after_start : own[j];
        }
    }
    const float *motion = leaving ? own : any;
    for (int64_t j = 0; j < count; j++) {
        const float after_any = any[j] + arrival[begin + j], after_start = motion[j] + arrival[begin + j];
        plain[j] = after_any > plain[j] ? after_any : plain[j];
        total[j] = after_start > total[j] ? after_start : total[j];
    }
}

/* Raise the totals of transfers from cell i to `count` cells from `begin` on by chains.

   time: of the transfers. total: with all that follows, beginning after the retract with a chain from the target before.
   plain: with chains that begin after the retract only. most: totals and plain totals from which on they are left. */
static void raise_by_chains(const Laws *laws, const Chains *chains, Boxes from, int64_t i, Boxes to, int64_t begin,
                            int64_t count, const float *arrival, const float *time, const float most[2], float *total,
                            float *plain)
{
    const float retract = chains->before ? chains->retract[i] : 0.0F;
    for (int64_t j = 0; j < count; j++) {
        if (total[j] >= most[0] && plain[j] >= most[1])
            continue;
        ChainTimes times = {0.0F, 0.0F, 0.0F};
        for (int32_t c = 0; c < laws->end[laws->classes - 1]; c++) {
            const int64_t column = laws->column[c], goal = column * to.count + begin + j;
            if (chains->law[column] < 0)
                continue;
            const float *table = chains->table + chains->law[column] * MOTIONS * chains->entries;
            const int64_t here = column * from.count + i, mirror = chains->coordinates * from.count;
            const int least = to.low[goal] - from.high[here], greatest = to.high[goal] - from.low[here];
            const int rise = chains->after[goal], fall = chains->after[chains->coordinates * to.count + goal];
            /* A retract rises where its line towards the target falls. */
            const int up = chains->before ? chains->before[mirror + here] : -1;
            const int down = chains->before ? chains->before[here] : -1;
            raise_by_joint(chains, table, up, rise, fall, least, greatest, &times);
            raise_by_joint(chains, table, down, fall, rise, -greatest, -least, &times);
        }
        const float approach = chains->approach[begin + j], onward = chains->onward[begin + j];
        const float late_retract = time[j] + chains->late[0], late_approach = time[j] + chains->late[1];
        const float from_retract = fminf(times.from_retract, late_approach + approach) + onward;
        const float to_approach = fminf(times.to_approach - retract, late_retract) + arrival[begin + j];
        const float late = fminf(late_retract, late_approach) + approach;
        const float whole = fminf(times.whole - retract, late) + onward;
        plain[j] = fmaxf(plain[j], from_retract);
        total[j] = fmaxf(fmaxf(total[j], from_retract), fmaxf(whole, to_approach));
    }
}

/* Compute lower bounds of the transfers from a run to `count` runs from `begin` on, with the time added there, at most TILE.

   arrival: least time added in each run of `to`. */
static void bound_runs(const Laws *laws, const CellRuns *from, int64_t run, const CellRuns *to, int64_t begin,
                       int64_t count, const float *arrival, float *bound)
{
    compute_row(laws, from->runs, run, to->runs, begin, count, bound);
    for (int64_t j = 0; j < count; j++)
        bound[j] += arrival[begin + j];
}

/* Raise these bounds by the speeds of joints at the lines' ends. */
static void raise_runs(const Laws *laws, const Chains *chains, const CellRuns *from, int64_t run, const CellRuns *to,
                       int64_t begin, int64_t count, const float *arrival, float *bound)
{
    float plain[TILE] = {0.0F};
    if (chains)
        raise_by_speeds(laws, chains, NULL, chains->speed[2], from->runs, run, to->runs, begin, count, arrival, bound,
                        plain);
}

/* Lower the least time of a pair of groups to that of the transfers between two runs including work; see `least_by_groups`. */
static void lower_pair(const Laws *laws, const CellRuns *from, int64_t run, const CellRuns *to, const float *work,
                       const Chains *chains, Candidate candidate, float *best)
{
    const int64_t begin = to->first[candidate.index], count = to->first[candidate.index + 1] - begin;
    float time[TILE], total[TILE], plain[TILE];
    for (int64_t i = from->first[run]; i < from->first[run + 1] && candidate.bound < *best; i++) {
        compute_row(laws, from->cells, i, to->cells, begin, count, time);
        for (int64_t j = 0; j < count; j++)
            total[j] = plain[j] = time[j] + work[begin + j];
        if (chains && minimum(total, 0, count) < *best)
            raise_by_speeds(laws, chains, chains->before ? chains->speed[0] : NULL, chains->speed[1], from->cells, i,
                            to->cells, begin, count, work, total, plain);
        const float sum = minimum(total, 0, count);
        *best = sum < *best ? sum : *best;
    }
}

/* Lower the least time of each pair of groups to that of the transfers between their cells including work.

   Joints may turn back at once. work: time added at each cell of `to`, (to->cells.count,). chains: laws of joints that
   pass line ends in motion; NULL for none. least: (groups, groups). Returns 0, or 1 if out of memory. */
int least_by_groups(const Laws *laws, const CellRuns *from, const CellRuns *to, const float *work, const Chains *chains,
                    int64_t groups, float *least)
{
    const int64_t goals = to->runs.count;
    Candidate *candidates = malloc(sizeof(Candidate) * (size_t)(goals + 1));
    float *bound = malloc(sizeof(float) * (size_t)(2 * goals + 1)), *least_work = bound + goals;
    if (!candidates || !bound) {
        free(candidates);
        free(bound);
        return 1;
    }
    for (int64_t r = 0; r < goals; r++)
        least_work[r] = minimum(work, to->first[r], to->first[r + 1]);
    for (int64_t run = 0; run < from->runs.count; run++) {
        float *best = least + from->group[from->first[run]] * groups;
        int64_t candidate_count = 0;
        for (int64_t begin = 0; begin < goals; begin += BLOCK) {
            const int64_t count = goals - begin < BLOCK ? goals - begin : BLOCK;
            int improves = 0;
            bound_runs(laws, from, run, to, begin, count, least_work, bound + begin);
            for (int64_t r = begin; r < begin + count; r++)
                improves |= bound[r] < best[to->group[to->first[r]]];
            if (!improves)
                continue;
            raise_runs(laws, chains, from, run, to, begin, count, least_work, bound + begin);
            for (int64_t r = begin; r < begin + count; r++)
                if (bound[r] < best[to->group[to->first[r]]])
                    candidates[candidate_count++] = (Candidate){bound[r], (int32_t)r};
        }
        qsort(candidates, (size_t)candidate_count, sizeof(Candidate), by_bound);
        for (int64_t p = 0; p < candidate_count; p++)
            lower_pair(laws, from, run, to, work, chains, candidates[p],
                       best + to->group[to->first[candidates[p].index]]);
    }
    free(candidates);
    free(bound);
    return 0;
}

/* Transfers whose sums with the times before and after are minimised for each cell of `from`. */
typedef struct {
    const Laws *laws;
    const CellRuns *from, *to;
    const Chains *chains;            /* NULL for none */
    const float *arrival, *remaining; /* times added at each cell of `to`, (to->cells.count,) */
    float *least, *least_plain;      /* after a retract that the chains begin with, and after any motion */
} Transfers;

/* Lower the least sums of cell i by the transfers to `count` cells from `goal` on, at most TILE. */
static void lower_sum(const Transfers *transfers, int64_t i, int64_t goal, int64_t count, float floor)
{
    const Boxes from = transfers->from->cells, to = transfers->to->cells;
    const Laws *laws = transfers->laws;
    const Chains *chains = transfers->chains;
    const float *arrival = transfers->arrival, *remaining = transfers->remaining;
    float *least = transfers->least + i, *least_plain = transfers->least_plain + i;
    float time[TILE], total[TILE], plain[TILE];
    compute_row(laws, from, i, to, goal, count, time);
    for (int64_t j = 0; j < count; j++) {
        const float arriving = time[j] + arrival[goal + j], waiting = floor + remaining[goal + j];
        total[j] = plain[j] = arriving > waiting ? arriving : waiting;
    }
    float sum = minimum(total, 0, count), plain_sum = sum;
    if (sum >= *least)
        return;
    if (chains) {
        raise_by_speeds(laws, chains, chains->before ? chains->speed[0] : NULL, chains->speed[1], from, i, to, goal,
                        count, arrival, total, plain);
        if (minimum(total, 0, count) >= *least && minimum(plain, 0, count) >= *least_plain)
            return;
        raise_by_chains(laws, chains, from, i, to, goal, count, arrival, time, (const float[2]){*least, *least_plain},
                        total, plain);
        sum = minimum(total, 0, count);
        plain_sum = minimum(plain, 0, count);
    }
    *least = sum < *least ? sum : *least;
    *least_plain = plain_sum < *least_plain ? plain_sum : *least_plain;
}

/* Lower the least sums of the cells of a run by the transfers to a run of `to`; return the greatest of them.

   bound: lower bound of the sums. floor: least duration of the stage. */
static float lower_sums(const Transfers *transfers, int64_t run, int64_t goal_run, float bound, float floor)
{
    const int64_t *first = transfers->from->first;
    const int64_t goal = transfers->to->first[goal_run], count = transfers->to->first[goal_run + 1] - goal;
    float greatest = 0.0F;
    for (int64_t i = first[run]; i < first[run + 1]; i++) {
        const float *least = transfers->least + i;
        if (bound < *least)
            lower_sum(transfers, i, goal, count, floor);
        greatest = *least > greatest ? *least : greatest;
    }
    return greatest;
}

/* Minimise max(transfer + arrival, floor + remaining) over the cells of `to` for each cell of `from`.

   arrival, remaining: times added at each cell of `to`, (to->cells.count,). chains: NULL for none. floor: of each pair
   of groups, (groups, groups). least: after a retract that the chains begin with, (from->cells.count,). least_plain:
   after any motion, (from->cells.count,). The pair of runs with the least bound tells which others may be better.
   Returns 0, or 1 if out of memory. */
int least_from(const Laws *laws, const CellRuns *from, const CellRuns *to, const float *arrival, const Chains *chains,
               const float *floor, const float *remaining, int64_t groups, float *least, float *least_plain)
{
    const Transfers transfers = {laws, from, to, chains, arrival, remaining, least, least_plain};
    const int64_t goals = to->runs.count;
    Candidate *candidates = malloc(sizeof(Candidate) * (size_t)(goals + 1));
    float *bound = malloc(sizeof(float) * (size_t)(4 * goals + 1));
    float *least_arrival = bound + goals, *waiting = bound + 2 * goals, *least_remaining = bound + 3 * goals;
    if (!candidates || !bound) {
        free(candidates);
        free(bound);
        return 1;
    }
    for (int64_t r = 0; r < goals; r++) {
        least_arrival[r] = minimum(arrival, to->first[r], to->first[r + 1]);
        least_remaining[r] = minimum(remaining, to->first[r], to->first[r + 1]);
    }
    for (int64_t run = 0; run < from->runs.count; run++) {
        const float *floors = floor + from->group[from->first[run]] * groups;
        int64_t first = -1, candidate_count = 0;
        for (int64_t i = from->first[run]; i < from->first[run + 1]; i++)
            least[i] = least_plain[i] = INFINITY;
        for (int64_t r = 0; r < goals; r += TILE)
            bound_runs(laws, from, run, to, r, goals - r < TILE ? goals - r : TILE, least_arrival, bound + r);
        for (int64_t r = 0; r < goals; r++) {
            waiting[r] = floors[to->group[to->first[r]]] + least_remaining[r];
            bound[r] = bound[r] > waiting[r] ? bound[r] : waiting[r];
            first = first < 0 || bound[r] < bound[first] ? r : first;
        }
        float most = INFINITY;
        if (first >= 0)
            most = lower_sums(&transfers, run, first, bound[first], floors[to->group[to->first[first]]]);
        for (int64_t begin = 0; begin < goals; begin += BLOCK) {
            const int64_t count = goals - begin < BLOCK ? goals - begin : BLOCK;
            if (minimum(bound, begin, begin + count) >= most)
                continue;
            raise_runs(laws, chains, from, run, to, begin, count, least_arrival, bound + begin);
            for (int64_t r = begin; r < begin + count; r++)
                if (bound[r] < most && r != first)
                    candidates[candidate_count++] = (Candidate){bound[r], (int32_t)r};
        }
        qsort(candidates, (size_t)candidate_count, sizeof(Candidate), by_bound);
        for (int64_t p = 0; p < candidate_count && candidates[p].bound < most; p++) {
            const int64_t r = candidates[p].index;
            most = lower_sums(&transfers, run, r, candidates[p].bound, floors[to->group[to->first[r]]]);
        }
    }
    free(candidates);
    free(bound);
    return 0;
}
