/* What it is worth to do other stops in some stages of two arms: `orders/paired/annealing.py` explains it. */

#include <math.h>
#include <stdint.h>

enum { ARMS = 2, MOST_ANGLES = 256, MOST_STAGES = 16 };

static const int64_t IDLE = -1;

/* A problem of `stops` stops and `angles` platform angles. Lengths of stages, by arm (stops + 1, stops + 2, angles,
   angles): from a stop, at an angle, to another, at another; the row `stops` is the start, the column `stops` the way
   back, the one after it nothing. Apart (stops + 2, stops + 2, angles) may be null. */
typedef struct {
    const double *length[ARMS];
    const float *apart;
    const double *turns_back; /* how long the platform takes back from each angle, (angles,) */
    int64_t stops, angles;
} Problem;

/* An order, start and way back included: stops, what came before them, and the next stage in which each arm has a stop,
   (stages, 2) each; platform angles and lengths, (stages,); sums of the lengths before each, (stages + 1,). */
typedef struct {
    const int64_t *rows, *came, *next, *angle;
    const double *cost, *sum;
} Line;

/* Lengths of an arm's part of a stage between all pairs of angles. */
static const double *lengths_of(const Problem *problem, int arm, int64_t came, int64_t stop)
{
    const int64_t column = stop == IDLE ? problem->stops + 1 : stop;
    return problem->length[arm] + (came * (problem->stops + 2) + column) * problem->angles * problem->angles;
}

static double apart_at(const Problem *problem, const int64_t stop[ARMS], int64_t angle)
{
    const int64_t side = problem->stops + 2;
    if (!problem->apart)
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
    const double *own[ARMS];
    for (int a = 0; a < ARMS; a++)
        /* An arm that never left has no way back. */
        own[a] = lengths_of(problem, a, came[a], back && came[a] == home ? IDLE : stop[a]);
    const double apart = back ? 0.0 : apart_at(problem, stop, angle);
    for (int64_t k = begin; k < end; k++) {
        const double one = own[0][k * f + angle], other = own[1][k * f + angle];
        const double longest = (one > other ? one : other) + apart;
        length[k - begin] = back && problem->turns_back[k] > longest ? problem->turns_back[k] : longest;
    }
}

/* The angle from which a stage at another one is over first, given when the stage before is over at each. */
static int64_t best_before(const Problem *problem, const int64_t came[ARMS], const int64_t *stop, int64_t angle,
                           const double *value)
{
    const int64_t f = problem->angles;
    const double *one = lengths_of(problem, 0, came[0], stop[0]), *other = lengths_of(problem, 1, came[1], stop[1]);
    double least = INFINITY;
    int64_t best = 0;
    for (int64_t k = 0; k < f; k++) {
        const double x = one[k * f + angle], y = other[k * f + angle], sum = value[k] + (x > y ? x : y);
        if (sum < least) {
            least = sum;
            best = k;
        }
    }
    return best;
}

/* Changes, `count` of `width` stages each: `first` (count,) of them, and their stops then, (count, width, 2). Sets by how
   much all is done later (count,), the angles that suit the stages best (count, width), and the last stage whose length
   is another one then (count,). Returns 0, or 1 where there are more angles or stages than it has room for. */
int change_worths(const Problem *problem, const Line *line, const int64_t *first, const int64_t *stops, int64_t count,
                  int64_t width, double *delta, int64_t *angles, int64_t *last)
{
    const int64_t f = problem->angles;
    if (f > MOST_ANGLES || width > MOST_STAGES)
        return 1;
    for (int64_t b = 0; b < count; b++) {
        /* Before each stage: when the one before is over, by its angle, and what both arms made last. */
        double values[MOST_STAGES + 1][MOST_ANGLES], rest[MOST_ANGLES];
        int64_t from[MOST_STAGES + 1][ARMS];
        const int64_t begin = first[b], end = begin + width;
        for (int64_t g = 0; g < f; g++)
            values[0][g] = g == line->angle[begin - 1] ? 0.0 : INFINITY;
        for (int a = 0; a < ARMS; a++)
            from[0][a] = line->came[ARMS * begin + a];
        for (int64_t i = 0; i < width; i++) {
            const int64_t *stop = stops + (b * width + i) * ARMS;
            double *restrict now = values[i + 1];
            for (int a = 0; a < ARMS; a++)
                from[i + 1][a] = stop[a] == IDLE ? from[i][a] : stop[a];
            if (stop[0] == IDLE && stop[1] == IDLE) {
                /* Where nobody does anything the platform stays. */
                for (int64_t g = 0; g < f; g++)
                    now[g] = values[i][g];
                continue;
            }
            const double *one = lengths_of(problem, 0, from[i][0], stop[0]);
            const double *other = lengths_of(problem, 1, from[i][1], stop[1]);
            for (int64_t g = 0; g < f; g++)
                now[g] = INFINITY;
            for (int64_t k = 0; k < f; k++) {
                const double so_far = values[i][k];
                if (!(so_far < INFINITY))
                    continue;
                for (int64_t g = 0; g < f; g++) {
                    const double x = one[k * f + g], y = other[k * f + g], sum = so_far + (x > y ? x : y);
                    now[g] = sum < now[g] ? sum : now[g];
                }
            }
            for (int64_t g = 0; g < f; g++)
                now[g] += apart_at(problem, stop, g);
        }
        const int64_t *came = from[width];
        length_to(problem, came, line->rows + ARMS * end, line->angle[end], 0, f, rest);
        int64_t at = 0;
        for (int64_t g = 0; g < f; g++) {
            rest[g] += values[width][g];
            at = rest[g] < rest[at] ? g : at;
        }
        delta[b] = rest[at] - (line->sum[end + 1] - line->sum[begin]);
        for (int64_t i = width - 1; i >= 0; i--) {
            const int64_t *stop = stops + (b * width + i) * ARMS;
            angles[b * width + i] = at;
            if (stop[0] != IDLE || stop[1] != IDLE)
                at = best_before(problem, from[i], stop, at, values[i]);
        }
        last[b] = end;
        for (int a = 0; a < ARMS; a++) {
            if (line->rows[ARMS * end + a] != IDLE)
                continue;
            /* An arm that is idle right after comes from elsewhere when it goes on. */
            const int64_t k = line->next[ARMS * end + a];
            int64_t other_came[ARMS] = {line->came[ARMS * k], line->came[ARMS * k + 1]};
            double anew;
            other_came[a] = came[a];
            length_to(problem, other_came, line->rows + ARMS * k, line->angle[k], line->angle[k - 1], line->angle[k - 1] + 1,
                      &anew);
            delta[b] += anew - line->cost[k];
            last[b] = k;
        }
    }
    return 0;
}
