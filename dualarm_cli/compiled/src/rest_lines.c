/* The fastest of a family of double-S shapes along a line from rest to rest; the method is explained in
   timing/line_profile.py. */

#include "paths.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

/* Share of the time that the ramp up takes, share of it that each of its jerk phases takes, and the same at the end. */
typedef struct {
    double start, start_jerk, end, end_jerk;
} Shape;

/* Returns the ends of the phases, (8,), and the states at their starts, (7,), see timing/shapes.py. */
static void phases_of(Shape shape, double *edge, State *state)
{
    const double r1 = shape.start, r2 = shape.end, x1 = r1 * shape.start_jerk, x2 = r2 * shape.end_jerk;
    const double p = 1.0 / (1.0 - (r1 + r2) / 2.0), a1 = p / (r1 - x1), a2 = p / (r2 - x2);
    const double gain1 = a1 * x1 / 2.0, gain2 = a2 * x2 / 2.0, way1 = gain1 * x1 / 3.0, way2 = gain2 * x2 / 3.0;
    const double ends[PHASES + 1] = {0.0, x1, r1 - x1, r1, 1.0 - r2, 1.0 - r2 + x2, 1.0 - x2, 1.0};
    const State states[PHASES] = {
        {0.0, 0.0, 0.0, a1 / x1},
        {way1, gain1, a1, 0.0},
        {p * (r1 / 2.0 - x1) + way1, p - gain1, a1, -a1 / x1},
        {p * r1 / 2.0, p, 0.0, 0.0},
        {1.0 - p * r2 / 2.0, p, 0.0, -a2 / x2},
        {1.0 - p * (r2 / 2.0 - x2) - way2, p - gain2, -a2, 0.0},
        {1.0 - way2, gain2, -a2, a2 / x2},
    };
    memcpy(edge, ends, sizeof ends);
    memcpy(state, states, sizeof states);
}

/* How long a shape must take, looked at at both ends and in the middle of each phase; infinite if `most` or more. */
static double shape_time(const Path *path, const Measures *measures, int64_t coordinate, Shape shape, double most)
{
    double edge[PHASES + 1], time = 0.0;
    State state[PHASES];
    phases_of(shape, edge, state);
    Needs needs = needs_of(path, measures, coordinate);
    for (int p = 0; p < PHASES; p++) {
        const double length = edge[p + 1] - edge[p];
        if (!(length > 0.0))
            continue;
        look(&needs, state[p]);
        look(&needs, advanced(state[p], 0.5 * length));
        look(&needs, advanced(state[p], length));
        time = needed_time(&needs);
        if (time >= most)
            return INFINITY;
    }
    return time;
}

/* The best shape found, and its coordinate: every coordinate with a grid of symmetric shapes, then variations of the best
   one's four shares. */
static Shape best_shape(const Path *path, const Measures *measures, int64_t *coordinate)
{
    static const double ramps[] = {0.5, 0.42, 0.34, 0.25, 0.17, 0.1}, jerks[] = {0.5, 0.35, 0.2, 0.08};
    /* What a coordinate's time counts: the third is rougher, so its few samples flatter it. */
    static const double handicap[COORDINATES] = {1.0, 1.0, 1.005};
    /* Each share alone, both ramps together and against each other, the same of their jerk phases, and all. */
    static const int change[][4] = {{1, 0, 0, 0}, {0, 1, 0, 0},  {0, 0, 1, 0}, {0, 0, 0, 1},  {1, 1, 0, 0},
                                    {1, -1, 0, 0}, {0, 0, 1, 1}, {1, 1, 1, 1}, {1, 1, -1, -1}};
    enum { CHANGES = sizeof change / sizeof *change, ROUNDS = 3 };
    /* Least shares of the time that a ramp, and of a ramp that each of its jerk phases may take. */
    const double shortest_ramp = 0.02, shortest_jerk = 0.02;
    Shape best = {0.5, 0.5, 0.5, 0.5};
    double least = INFINITY;
    *coordinate = 0;
    for (int64_t c = 0; c < COORDINATES; c++)
        for (size_t r = 0; r < sizeof ramps / sizeof *ramps; r++)
            for (size_t j = 0; j < sizeof jerks / sizeof *jerks; j++) {
                const Shape tried = {ramps[r], jerks[j], ramps[r], jerks[j]};
                const double time = shape_time(path, measures, c, tried, least / handicap[c]) * handicap[c];
                if (time < least * (1.0 - 1e-12)) {
                    least = time;
                    best = tried;
                    *coordinate = c;
                }
            }
    least /= handicap[*coordinate];
    /* Factors by which ramps and jerk phases are varied in the first round, their roots in the next. */
    double wide[2] = {1.4, 2.5};
    for (int round = 0; round < ROUNDS; round++) {
        const Shape from = best;
        for (int k = 0; k < 2 * CHANGES; k++) {
            double by[4];
            for (int i = 0; i < 4; i++) {
                const int up = k < CHANGES ? change[k][i] : -change[k - CHANGES][i];
                by[i] = up > 0 ? wide[i / 2] : up < 0 ? 1.0 / wide[i / 2] : 1.0;
            }
            const double start = within(from.start * by[0], shortest_ramp, 0.9);
            const double end = within(from.end * by[1], shortest_ramp, 0.9), whole = larger(start + end, 1.0);
            const Shape tried = {start / whole, within(from.start_jerk * by[2], shortest_jerk, 0.5), end / whole,
                                 within(from.end_jerk * by[3], shortest_jerk, 0.5)};
            const double time = shape_time(path, measures, *coordinate, tried, least);
            if (time < least * (1.0 - 1e-12)) {
                least = time;
                best = tried;
            }
        }
        wide[0] = sqrt(wide[0]);
        wide[1] = sqrt(wide[1]);
    }
    return best;
}

/* At least `wanted` knots in [0, 1]: every end of a phase and equal parts within, three or more in the end phases, since
   their first two knots belong to the boundary. Returns how many. */
static int64_t shape_knots(Shape shape, int64_t wanted, double *time, double *way)
{
    double edge[PHASES + 1];
    State state[PHASES];
    int real[PHASES], count = 0;
    int64_t knots = 0;
    phases_of(shape, edge, state);
    for (int p = 0; p < PHASES; p++)
        if (edge[p + 1] - edge[p] > 1e-6)
            real[count++] = p;
    for (int r = 0; r < count; r++) {
        const double low = edge[real[r]], high = r + 1 < count ? edge[real[r + 1]] : 1.0;
        int64_t parts = (int64_t)ceil((high - low) * (double)wanted);
        const int64_t least = r == 0 || r == count - 1 ? 3 : 1;
        parts = parts < least ? least : parts;
        for (int64_t i = 0; i < parts; i++) {
            const double dt = (double)i * ((high - low) / (double)parts);
            time[knots] = low + dt;
            way[knots++] = within(advanced(state[real[r]], dt).way, 0.0, 1.0);
        }
    }
    time[knots] = way[knots] = 1.0;
    return knots + 1;
}

/* Times a line from rest to rest with at least `wanted` knots, at most 16 more. Returns how many, or 0 without memory. */
int64_t rest_line(const Path *path, int64_t wanted, const Motion *found)
{
    Measures measures;
    double *way = malloc(sizeof(double) * (size_t)(wanted + 16));
    if (!way || measure(path, &measures)) {
        free(way);
        return 0;
    }
    int64_t coordinate;
    const Shape shape = best_shape(path, &measures, &coordinate);
    const int64_t knots = shape_knots(shape, wanted, found->time, way);
    const int failed = along(path, measures.share + coordinate * path->samples, way, knots, NULL, *found);
    release(&measures);
    free(way);
    return failed ? 0 : knots;
}
