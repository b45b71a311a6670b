/* Rest-to-rest profiles of lines: the fastest of a family of double-S shapes. Method: timing/line_profile.py. */

#include "paths.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

/* Double-S shape: fractions of the duration taken by the ramps at start and end, and fractions of each ramp taken by
   each of its jerk phases. */
typedef struct {
    double start, start_jerk, end, end_jerk;
} Shape;

/* Compute the boundaries of the phases, (8,), and the states at their starts, (7,), as timing/shapes.py. */
static void shape_phases(Shape shape, double *boundary, State *state)
{
    const double r1 = shape.start, r2 = shape.end, x1 = r1 * shape.start_jerk, x2 = r2 * shape.end_jerk;
    const double p = 1.0 / (1.0 - (r1 + r2) / 2.0), a1 = p / (r1 - x1), a2 = p / (r2 - x2);
    const double speed1 = a1 * x1 / 2.0, speed2 = a2 * x2 / 2.0;
    const double distance1 = speed1 * x1 / 3.0, distance2 = speed2 * x2 / 3.0;
    const double boundaries[PHASES + 1] = {0.0, x1, r1 - x1, r1, 1.0 - r2, 1.0 - r2 + x2, 1.0 - x2, 1.0};
    const State states[PHASES] = {
        {0.0, 0.0, 0.0, a1 / x1},
        {distance1, speed1, a1, 0.0},
        {p * (r1 / 2.0 - x1) + distance1, p - speed1, a1, -a1 / x1},
        {p * r1 / 2.0, p, 0.0, 0.0},
        {1.0 - p * r2 / 2.0, p, 0.0, -a2 / x2},
        {1.0 - p * (r2 / 2.0 - x2) - distance2, p - speed2, -a2, 0.0},
        {1.0 - distance2, speed2, -a2, a2 / x2},
    };
    memcpy(boundary, boundaries, sizeof boundaries);
    memcpy(state, states, sizeof states);
}

/* Compute the least duration of a shape [s], infinite if it is `max_time` or more.

   Limits are checked at both ends and in the middle of each phase. */
static double shape_time(const Path *path, const Measures *measures, int64_t coordinate, Shape shape, double max_time)
{
    double boundary[PHASES + 1], time = 0.0;
    State state[PHASES];
    shape_phases(shape, boundary, state);
    Peaks peaks = start_peaks(path, measures, coordinate);
    for (int p = 0; p < PHASES; p++) {
        const double length = boundary[p + 1] - boundary[p];
        if (!(length > 0.0))
            continue;
        add_state(&peaks, state[p]);
        add_state(&peaks, advance(state[p], 0.5 * length));
        add_state(&peaks, advance(state[p], length));
        time = min_duration(&peaks);
        if (time >= max_time)
            return INFINITY;
    }
    return time;
}

/* Search the fastest shape and its path coordinate.

   First a grid of symmetric shapes along every coordinate, then variations of the four fractions of the best one. */
static Shape best_shape(const Path *path, const Measures *measures, int64_t *coordinate)
{
    static const double ramps[] = {0.5, 0.42, 0.34, 0.25, 0.17, 0.1}, jerks[] = {0.5, 0.35, 0.2, 0.08};
    /* Factors on the times of the coordinates: those of the third, rougher one are too short with few samples. */
    static const double penalty[COORDINATES] = {1.0, 1.0, 1.005};
    /* Each fraction alone, both ramps in the same and in opposite directions, both jerk fractions in the same
       direction, and all four. */
    static const int variation[][4] = {{1, 0, 0, 0}, {0, 1, 0, 0},  {0, 0, 1, 0}, {0, 0, 0, 1},  {1, 1, 0, 0},
                                       {1, -1, 0, 0}, {0, 0, 1, 1}, {1, 1, 1, 1}, {1, 1, -1, -1}};
    enum { VARIATIONS = sizeof variation / sizeof *variation, ROUNDS = 3 };
    /* Least fractions of the duration for a ramp, and of a ramp for each of its jerk phases. */
    const double min_ramp = 0.02, min_jerk = 0.02;
    Shape best = {0.5, 0.5, 0.5, 0.5};
    double min_time = INFINITY;
    *coordinate = 0;
    for (int64_t c = 0; c < COORDINATES; c++)
        for (size_t r = 0; r < sizeof ramps / sizeof *ramps; r++)
            for (size_t j = 0; j < sizeof jerks / sizeof *jerks; j++) {
                const Shape candidate = {ramps[r], jerks[j], ramps[r], jerks[j]};
                const double time = shape_time(path, measures, c, candidate, min_time / penalty[c]) * penalty[c];
                if (time < min_time * (1.0 - 1e-12)) {
                    min_time = time;
                    best = candidate;
                    *coordinate = c;
                }
            }
    min_time /= penalty[*coordinate];
    /* Factors on ramps and jerk phases in the first round; each following round takes their square roots. */
    double factors[2] = {1.4, 2.5};
    for (int round = 0; round < ROUNDS; round++) {
        const Shape base = best;
        for (int k = 0; k < 2 * VARIATIONS; k++) {
            double factor[4];
            for (int i = 0; i < 4; i++) {
                const int up = k < VARIATIONS ? variation[k][i] : -variation[k - VARIATIONS][i];
                factor[i] = up > 0 ? factors[i / 2] : up < 0 ? 1.0 / factors[i / 2] : 1.0;
            }
            const double start = clamp(base.start * factor[0], min_ramp, 0.9);
            const double end = clamp(base.end * factor[1], min_ramp, 0.9), total = larger(start + end, 1.0);
            const Shape candidate = {start / total, clamp(base.start_jerk * factor[2], min_jerk, 0.5), end / total,
                                     clamp(base.end_jerk * factor[3], min_jerk, 0.5)};
            const double time = shape_time(path, measures, *coordinate, candidate, min_time);
            if (time < min_time * (1.0 - 1e-12)) {
                min_time = time;
                best = candidate;
            }
        }
        factors[0] = sqrt(factors[0]);
        factors[1] = sqrt(factors[1]);
    }
    return best;
}

/* Place at least `min_knots` knots in [0, 1], at the ends of all phases and evenly within; return their number.

   The first and last phase have three or more because the spline's boundary conditions take two knots at each end. */
static int64_t shape_knots(Shape shape, int64_t min_knots, double *time, double *distance)
{
    double boundary[PHASES + 1];
    State state[PHASES];
    int nonempty[PHASES], count = 0;
    int64_t knots = 0;
    shape_phases(shape, boundary, state);
    for (int p = 0; p < PHASES; p++)
        if (boundary[p + 1] - boundary[p] > 1e-6)
            nonempty[count++] = p;
    for (int r = 0; r < count; r++) {
        const double low = boundary[nonempty[r]], high = r + 1 < count ? boundary[nonempty[r + 1]] : 1.0;
        int64_t parts = (int64_t)ceil((high - low) * (double)min_knots);
        const int64_t min_parts = r == 0 || r == count - 1 ? 3 : 1;
        parts = parts < min_parts ? min_parts : parts;
        for (int64_t i = 0; i < parts; i++) {
            const double dt = (double)i * ((high - low) / (double)parts);
            time[knots] = low + dt;
            distance[knots++] = clamp(advance(state[nonempty[r]], dt).position, 0.0, 1.0);
        }
    }
    time[knots] = distance[knots] = 1.0;
    return knots + 1;
}

/* Time a line from rest to rest with `min_knots` knots or up to 16 more; return their number, or 0 if out of memory. */
int64_t rest_line(const Path *path, int64_t min_knots, const Motion *motion)
{
    Measures measures;
    double *distance = malloc(sizeof(double) * (size_t)(min_knots + 16));
    if (!distance || measure_path(path, &measures)) {
        free(distance);
        return 0;
    }
    int64_t coordinate;
    const Shape shape = best_shape(path, &measures, &coordinate);
    const int64_t knots = shape_knots(shape, min_knots, motion->time, distance);
    const double *fraction = measures.fraction + coordinate * path->samples;
    const int failed = spline_along_path(path, fraction, distance, knots, NULL, *motion);
    free_measures(&measures);
    free(distance);
    return failed ? 0 : knots;
}
