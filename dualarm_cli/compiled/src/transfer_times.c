/* Rest-to-rest times between boxes of joint coordinates, looked up in tables; what bounds and potentials are made of.

   Coordinates are steps of a table (int16), coordinate first: x[c * count + i]. Joints with laws in the same proportions
   form a class with one table; a transfer takes the longest of all classes' times over their largest gaps. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

typedef struct {
    const float *table;    /* times of every number of steps, class by class, (classes, steps) */
    const int32_t *column; /* coordinates of all classes, one class after the other */
    const int32_t *end;    /* where each class ends in `column`, (classes,) */
    int32_t classes, steps;
} Laws;

typedef struct {
    const int16_t *low, *high; /* of every box, (coordinates, count) */
    int64_t count;
} Boxes;

typedef struct {
    Boxes cells;
    const int64_t *group; /* platform cell of each, ascending, (count,) */
    Boxes runs;           /* around cells next to each other in one group */
    const int64_t *first; /* first cell of each run, and the number of cells, (runs + 1,) */
} Side;

enum { TILE = 512, PART = 32 };

/* Times from box i to `count` boxes from `begin` on; at most TILE of them. */
static void row_times(const Laws *laws, Boxes from, int64_t i, Boxes to, int64_t begin, int64_t count, float *time)
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
                /* Between points the gap is the same either way. */
                for (int64_t j = 0; j < count; j++) {
                    const int16_t over = (int16_t)(goal_low[j] - low), under = (int16_t)-over;
                    const int16_t most = over > under ? over : under;
                    gap[j] = gap[j] > most ? gap[j] : most;
                }
                continue;
            }
            for (int64_t j = 0; j < count; j++) {
                const int16_t over = (int16_t)(goal_low[j] - high), under = (int16_t)(low - goal_high[j]);
                const int16_t most = over > under ? over : under;
                gap[j] = gap[j] > most ? gap[j] : most;
            }
        }
        const float *table = laws->table + (int64_t)k * laws->steps;
        for (int64_t j = 0; j < count; j++) {
            const float own = table[gap[j]];
            time[j] = k == 0 || own > time[j] ? own : time[j];
        }
    }
}

/* Times of all pairs, (from.count, to.count). */
void gap_times(const Laws *laws, const Boxes *from, const Boxes *to, float *time)
{
    for (int64_t i = 0; i < from->count; i++)
        for (int64_t j = 0; j < to->count; j += TILE) {
            const int64_t count = to->count - j < TILE ? to->count - j : TILE;
            row_times(laws, *from, i, *to, j, count, time + i * to->count + j);
        }
}

/* Minima at once, so that the compiler can take them together. */
enum { LANES = 8 };

static float least_of(const float *value, int64_t begin, int64_t end)
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

/* Times of all pairs with `work` (of each box of `to`), (from->count, to->count), and the least of them for every pair of
   groups, (groups, groups), which is infinite at first. `group` is that of each box of `from`; `first` is the first box
   of each group of `to`, and their number, (groups + 1,). */
void work_times(const Laws *laws, const Boxes *from, const Boxes *to, const float *work, const int64_t *group,
                const int64_t *first, int64_t groups, float *time, float *least)
{
    gap_times(laws, from, to, time);
    for (int64_t i = 0; i < from->count; i++) {
        float *row = time + i * to->count, *best = least + group[i] * groups;
        for (int64_t j = 0; j < to->count; j++)
            row[j] += work[j];
        for (int64_t g = 0; g < groups; g++) {
            const float own = least_of(row, first[g], first[g + 1]);
            best[g] = own < best[g] ? own : best[g];
        }
    }
}

/* The least of max(time, floor) + left from every row, (rows,): time (rows, count), floor of every pair of groups,
   (groups, groups), the row's and the column's, left of every column. Returns 0, or 1 without memory. */
int least_through(const float *time, int64_t rows, int64_t count, const int64_t *group, const int64_t *column,
                  int64_t groups, const float *floor, const float *left, float *least)
{
    float *own = malloc(sizeof(float) * (size_t)(2 * count + 1));
    if (!own)
        return 1;
    float *all = own + count;
    for (int64_t i = 0; i < rows; i++) {
        /* Rows come in order of their groups. */
        if (!i || group[i] != group[i - 1])
            for (int64_t j = 0; j < count; j++)
                own[j] = floor[group[i] * groups + column[j]];
        const float *row = time + i * count;
        for (int64_t j = 0; j < count; j++)
            all[j] = (row[j] > own[j] ? row[j] : own[j]) + left[j];
        least[i] = least_of(all, 0, count);
    }
    free(own);
    return 0;
}

/* One end of a stop's lines. */
typedef struct {
    Boxes cells;
    const int64_t *first; /* first cell of every group, and the number of cells, (groups + 1,) */
    const float *line;    /* least time of the line there */
} End;

/* A run or part of cells, and what it can give at best. */
typedef struct {
    float bound;
    int32_t place;
} Promise;

static int by_bound(const void *one, const void *other)
{
    const Promise *a = one, *b = other;
    if (a->bound != b->bound)
        return a->bound < b->bound ? -1 : 1;
    return a->place - b->place;
}

/* From every cell of `approach` the least over all cells of `retract` in its group of max(way between them, both
   lines) + rest, (approach->cells.count,): infinite without any. Parts of a group are looked at in order of what their
   lines and rests can give at best. Returns 0, or 1 without memory. */
int least_work(const Laws *laws, const End *approach, const End *retract, int64_t groups, const float *rest,
               float *least)
{
    Promise *promise = malloc(sizeof(Promise) * (size_t)(retract->cells.count / PART + 1));
    float time[PART];
    if (!promise)
        return 1;
    for (int64_t g = 0; g < groups; g++) {
        const int64_t begin = retract->first[g], end = retract->first[g + 1], parts = (end - begin + PART - 1) / PART;
        for (int64_t r = 0; r < parts; r++) {
            const int64_t j = begin + r * PART, past = j + PART < end ? j + PART : end;
            promise[r] = (Promise){least_of(retract->line, j, past) + least_of(rest, j, past), (int32_t)r};
        }
        qsort(promise, (size_t)parts, sizeof(Promise), by_bound);
        for (int64_t i = approach->first[g]; i < approach->first[g + 1]; i++) {
            const float line = approach->line[i];
            float best = INFINITY;
            /* Sums are not rounded alike in any order: a millionth covers that. */
            for (int64_t r = 0; r < parts && line + promise[r].bound < best * (1.0F + 1e-6F); r++) {
                const int64_t j = begin + promise[r].place * PART, count = end - j < PART ? end - j : PART;
                row_times(laws, approach->cells, i, retract->cells, j, count, time);
                for (int64_t k = 0; k < count; k++) {
                    const float lines = line + retract->line[j + k];
                    const float whole = (time[k] > lines ? time[k] : lines) + rest[j + k];
                    best = whole < best ? whole : best;
                }
            }
            least[i] = best;
        }
    }
    free(promise);
    return 0;
}

/* The least of transfer and `work` (of each cell of `to`) for every pair of groups, (groups, groups); infinite at first.
   Returns 0, or 1 without memory. */
int least_by_groups(const Laws *laws, const Side *from, const Side *to, const float *work, int64_t groups, float *least)
{
    const int64_t goals = to->runs.count;
    Promise *promise = malloc(sizeof(Promise) * (size_t)(goals + 1));
    float *bound = malloc(sizeof(float) * (size_t)(2 * goals + 1)), *least_work = bound + goals, time[TILE];
    if (!promise || !bound) {
        free(promise);
        free(bound);
        return 1;
    }
    for (int64_t r = 0; r < goals; r++)
        least_work[r] = least_of(work, to->first[r], to->first[r + 1]);
    for (int64_t k = 0; k < from->runs.count; k++) {
        float *best = least + from->group[from->first[k]] * groups;
        for (int64_t r = 0; r < goals; r += TILE)
            row_times(laws, from->runs, k, to->runs, r, goals - r < TILE ? goals - r : TILE, bound + r);
        int64_t promising = 0;
        for (int64_t r = 0; r < goals; r++) {
            const float own = bound[r] + least_work[r];
            if (own < best[to->group[to->first[r]]])
                promise[promising++] = (Promise){own, (int32_t)r};
        }
        qsort(promise, (size_t)promising, sizeof(Promise), by_bound);
        for (int64_t p = 0; p < promising; p++) {
            const int64_t r = promise[p].place, begin = to->first[r], count = to->first[r + 1] - begin;
            float *here = best + to->group[begin];
            for (int64_t i = from->first[k]; i < from->first[k + 1] && promise[p].bound < *here; i++) {
                row_times(laws, from->cells, i, to->cells, begin, count, time);
                for (int64_t j = 0; j < count; j++) {
                    const float sum = time[j] + work[begin + j];
                    *here = sum < *here ? sum : *here;
                }
            }
        }
    }
    free(promise);
    free(bound);
    return 0;
}

/* From every cell of `from` the least over all cells of `to` of max(transfer + own, floor + beyond), (from.count,):
   own and beyond are of each cell where a transfer ends, floor of each pair of groups, (groups, groups).
   Returns 0, or 1 without memory. */
int least_from(const Laws *laws, const Side *from, const Side *to, const float *own, const float *floor,
               const float *beyond, int64_t groups, float *least)
{
    const int64_t goals = to->runs.count;
    Promise *promise = malloc(sizeof(Promise) * (size_t)(goals + 1));
    float *bound = malloc(sizeof(float) * (size_t)(3 * goals + 1)), time[TILE];
    float *least_own = bound + goals, *least_beyond = bound + 2 * goals;
    if (!promise || !bound) {
        free(promise);
        free(bound);
        return 1;
    }
    for (int64_t r = 0; r < goals; r++) {
        least_own[r] = least_of(own, to->first[r], to->first[r + 1]);
        least_beyond[r] = least_of(beyond, to->first[r], to->first[r + 1]);
    }
    for (int64_t k = 0; k < from->runs.count; k++) {
        const int64_t begin = from->first[k], end = from->first[k + 1];
        const float *floors = floor + from->group[begin] * groups;
        for (int64_t i = begin; i < end; i++)
            least[i] = INFINITY;
        for (int64_t r = 0; r < goals; r += TILE)
            row_times(laws, from->runs, k, to->runs, r, goals - r < TILE ? goals - r : TILE, bound + r);
        for (int64_t r = 0; r < goals; r++) {
            const float one = bound[r] + least_own[r], other = floors[to->group[to->first[r]]] + least_beyond[r];
            promise[r] = (Promise){one > other ? one : other, (int32_t)r};
        }
        qsort(promise, (size_t)goals, sizeof(Promise), by_bound);
        for (int64_t p = 0; p < goals; p++) {
            const int64_t r = promise[p].place, goal = to->first[r], count = to->first[r + 1] - goal;
            const float here = floors[to->group[goal]];
            int better = 0;
            for (int64_t i = begin; i < end; i++) {
                if (promise[p].bound >= least[i])
                    continue;
                better = 1;
                row_times(laws, from->cells, i, to->cells, goal, count, time);
                for (int64_t j = 0; j < count; j++) {
                    const float one = time[j] + own[goal + j], other = here + beyond[goal + j];
                    const float sum = one > other ? one : other;
                    least[i] = sum < least[i] ? sum : least[i];
                }
            }
            if (!better)
                break;
        }
    }
    free(promise);
    free(bound);
    return 0;
}
