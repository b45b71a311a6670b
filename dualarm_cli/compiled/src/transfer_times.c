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

/* Compute the times from box i to `count` boxes from `begin` on, at most TILE. */
static void compute_row(const Laws *laws, Boxes from, int64_t i, Boxes to, int64_t begin, int64_t count, float *time)
{
    int16_t gap[TILE];
    int32_t c = 0;
    for (int32_t k = 0; k < laws->classes; k++) {
        for (int64_t j = 0; j < count; j++)
            gap[j] = 0;
        for (; c < laws->end[k]; c++) {
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

/* Minimise max(transfer, both lines) + remaining over the retract cells in the group of each approach cell.

   remaining: of each retract cell, (retract->cells.count,). least: infinite for groups without retract cells,
   (approach->cells.count,). Blocks of a group are searched in order of the bounds from their lines and remaining times.
   Returns 0, or 1 if out of memory. */
int least_work(const Laws *laws, const LineEnds *approach, const LineEnds *retract, int64_t groups,
               const float *remaining, float *least)
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
            const float bound = minimum(retract->line, j, block_end) + minimum(remaining, j, block_end);
            candidates[b] = (Candidate){bound, (int32_t)b};
        }
        qsort(candidates, (size_t)blocks, sizeof(Candidate), by_bound);
        for (int64_t i = approach->first[g]; i < approach->first[g + 1]; i++) {
            const float line = approach->line[i];
            float best = INFINITY;
            /* A relative margin of 1e-6 covers the rounding of sums in a different order. */
            for (int64_t b = 0; b < blocks && line + candidates[b].bound < best * (1.0F + 1e-6F); b++) {
                const int64_t j = begin + candidates[b].index * BLOCK, count = end - j < BLOCK ? end - j : BLOCK;
                compute_row(laws, approach->cells, i, retract->cells, j, count, time);
                for (int64_t k = 0; k < count; k++) {
                    const float line_times = line + retract->line[j + k];
                    const float total = (time[k] > line_times ? time[k] : line_times) + remaining[j + k];
                    best = total < best ? total : best;
                }
            }
            least[i] = best;
        }
    }
    free(candidates);
    return 0;
}

/* Joints that turn back between a transfer and the approach after it; method: `model/rest_to_rest.py`. */
typedef struct {
    const float *back;  /* least time from turning back after a rise, and after a fall, to the target [s], 0 for none,
                           (2, coordinates, count) */
    const float *late;  /* least time of an approach for which `back` need not hold [s], (count,) */
    const float *ramp;  /* least time from full speed to zero, 0 for coordinates that do not count, (coordinates,) */
    const float *after; /* least time from the target on by platform cell [s], (groups,) */
    int64_t coordinates;
    float step;         /* time of a table step at full speed [s] */
} Turns;

/* Raise the totals of transfers from cell i to `count` cells from `begin` on by joints that turn back, at most TILE.

   time: of the transfers. total: with all that follows. */
static void raise_by_turns(const Laws *laws, const Turns *turns, Boxes from, int64_t i, Boxes to, int64_t begin,
                           int64_t count, float after, const float *time, float *total)
{
    float turning[TILE];
    for (int64_t j = 0; j < count; j++)
        turning[j] = 0.0F;
    for (int32_t c = 0; c < laws->end[laws->classes - 1]; c++) {
        const int64_t column = laws->column[c];
        const float ramp = turns->ramp[column];
        for (int fall = 0; fall < 2 && ramp > 0.0F; fall++) {
            const int16_t here = fall ? from.low[column * from.count + i] : from.high[column * from.count + i];
            const int16_t *goal = (fall ? to.high : to.low) + column * to.count + begin;
            const float *back = turns->back + (column + fall * turns->coordinates) * to.count + begin;
            for (int64_t j = 0; j < count; j++) {
                const int gap = (fall ? here - goal[j] : goal[j] - here) - 1;
                const float way = gap > 0 ? (float)gap * turns->step : 0.0F;
                const float out = way > 0.5F * ramp ? way + 0.5F * ramp : sqrtf(2.0F * ramp * way);
                const float turned = gap > 0 && back[j] > 0.0F ? out + back[j] : 0.0F;
                turning[j] = turned > turning[j] ? turned : turning[j];
            }
        }
    }
    for (int64_t j = 0; j < count; j++) {
        const float late = time[j] + turns->late[begin + j];
        const float least = (turning[j] < late ? turning[j] : late) + after;
        total[j] = least > total[j] ? least : total[j];
    }
}

/* Lower the least time of each pair of groups to that of the transfers between their cells including work.

   work: time added at each cell of `to`, (to->cells.count,). turns: NULL for none. least: (groups, groups).
   Returns 0, or 1 if out of memory. */
int least_by_groups(const Laws *laws, const CellRuns *from, const CellRuns *to, const float *work, const Turns *turns,
                    int64_t groups, float *least)
{
    const int64_t goals = to->runs.count;
    Candidate *candidates = malloc(sizeof(Candidate) * (size_t)(goals + 1));
    float *bound = malloc(sizeof(float) * (size_t)(2 * goals + 1)), *least_work = bound + goals, time[TILE], total[TILE];
    if (!candidates || !bound) {
        free(candidates);
        free(bound);
        return 1;
    }
    for (int64_t r = 0; r < goals; r++)
        least_work[r] = minimum(work, to->first[r], to->first[r + 1]);
    for (int64_t run = 0; run < from->runs.count; run++) {
        float *best = least + from->group[from->first[run]] * groups;
        for (int64_t r = 0; r < goals; r += TILE)
            compute_row(laws, from->runs, run, to->runs, r, goals - r < TILE ? goals - r : TILE, bound + r);
        int64_t candidate_count = 0;
        for (int64_t r = 0; r < goals; r++) {
            const float total = bound[r] + least_work[r];
            if (total < best[to->group[to->first[r]]])
                candidates[candidate_count++] = (Candidate){total, (int32_t)r};
        }
        qsort(candidates, (size_t)candidate_count, sizeof(Candidate), by_bound);
        for (int64_t p = 0; p < candidate_count; p++) {
            const int64_t r = candidates[p].index, begin = to->first[r], count = to->first[r + 1] - begin;
            float *pair_best = best + to->group[begin];
            for (int64_t i = from->first[run]; i < from->first[run + 1] && candidates[p].bound < *pair_best; i++) {
                compute_row(laws, from->cells, i, to->cells, begin, count, time);
                for (int64_t j = 0; j < count; j++)
                    total[j] = time[j] + work[begin + j];
                if (turns && minimum(total, 0, count) < *pair_best)
                    raise_by_turns(laws, turns, from->cells, i, to->cells, begin, count,
                                   turns->after[to->group[begin]], time, total);
                const float sum = minimum(total, 0, count);
                *pair_best = sum < *pair_best ? sum : *pair_best;
            }
        }
    }
    free(candidates);
    free(bound);
    return 0;
}

/* Minimise max(transfer + arrival, floor + remaining) over the cells of `to` for each cell of `from`.

   arrival, remaining: times added at each cell of `to`, (to->cells.count,). turns: NULL for none. floor: of each pair of
   groups, (groups, groups). least: (from->cells.count,).
   Returns 0, or 1 if out of memory. */
int least_from(const Laws *laws, const CellRuns *from, const CellRuns *to, const float *arrival, const Turns *turns,
               const float *floor, const float *remaining, int64_t groups, float *least)
{
    const int64_t goals = to->runs.count;
    Candidate *candidates = malloc(sizeof(Candidate) * (size_t)(goals + 1));
    float *bound = malloc(sizeof(float) * (size_t)(3 * goals + 1)), time[TILE], total[TILE];
    float *least_arrival = bound + goals, *least_remaining = bound + 2 * goals;
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
        const int64_t begin = from->first[run], end = from->first[run + 1];
        const float *floors = floor + from->group[begin] * groups;
        for (int64_t i = begin; i < end; i++)
            least[i] = INFINITY;
        for (int64_t r = 0; r < goals; r += TILE)
            compute_row(laws, from->runs, run, to->runs, r, goals - r < TILE ? goals - r : TILE, bound + r);
        for (int64_t r = 0; r < goals; r++) {
            const float arriving = bound[r] + least_arrival[r];
            const float waiting = floors[to->group[to->first[r]]] + least_remaining[r];
            candidates[r] = (Candidate){arriving > waiting ? arriving : waiting, (int32_t)r};
        }
        qsort(candidates, (size_t)goals, sizeof(Candidate), by_bound);
        for (int64_t p = 0; p < goals; p++) {
            const int64_t r = candidates[p].index, goal = to->first[r], count = to->first[r + 1] - goal;
            const float pair_floor = floors[to->group[goal]];
            int improved = 0;
            for (int64_t i = begin; i < end; i++) {
                if (candidates[p].bound >= least[i])
                    continue;
                improved = 1;
                compute_row(laws, from->cells, i, to->cells, goal, count, time);
                for (int64_t j = 0; j < count; j++) {
                    const float arriving = time[j] + arrival[goal + j], waiting = pair_floor + remaining[goal + j];
                    total[j] = arriving > waiting ? arriving : waiting;
                }
                if (turns && minimum(total, 0, count) < least[i])
                    raise_by_turns(laws, turns, from->cells, i, to->cells, goal, count,
                                   turns->after[to->group[goal]], time, total);
                const float sum = minimum(total, 0, count);
                least[i] = sum < least[i] ? sum : least[i];
            }
            if (!improved)
                break;
        }
    }
    free(candidates);
    free(bound);
    return 0;
}
