/* Rest-to-rest profiles of lines: the fastest of a family of double-S shapes. Method: timing/line_profile.py. */

#include "paths.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

/* Double-S shape: fractions of the duration taken by the ramps at start and end, and fractions of each ramp taken by
   its jerk phase next to rest and by its inner one, next to the constant speed. */
typedef struct {
    double start, start_jerk, start_inner, end, end_jerk, end_inner;
} Shape;

/* Compute the boundaries of the phases and the states there, (8,) each, as timing/shapes.py. */
static void shape_phases(Shape shape, double *boundary, State *state)
{
    const double r1 = shape.start, r2 = shape.end, x1 = r1 * shape.start_jerk, x2 = r2 * shape.end_jerk;
    const double y1 = r1 * shape.start_inner, y2 = r2 * shape.end_inner;
    /* Accelerations with which both ramps reach the speed 1. */
    const double a1 = 1.0 / (r1 - (x1 + y1) / 2.0), a2 = 1.0 / (r2 - (x2 + y2) / 2.0);
    const double boundaries[PHASES + 1] = {0.0, x1, r1 - y1, r1, 1.0 - r2, 1.0 - r2 + y2, 1.0 - x2, 1.0};
    const double jerk[PHASES] = {a1 / x1, 0.0, -a1 / y1, 0.0, -a2 / y2, 0.0, a2 / x2};
    double length[PHASES];
    for (int p = 0; p < PHASES; p++)
        length[p] = boundaries[p + 1] - boundaries[p];
    states_of_phases(length, jerk, state);
    memcpy(boundary, boundaries, sizeof boundaries);
}

/* Compute the least duration of a shape [s], infinite if it is `max_time` or more.

   Limits are checked at both ends and in the middle of each phase. */
static double shape_time(const Path *path, const Measures *measures, int64_t coordinate, Shape shape, double max_time)
{
    double boundary[PHASES + 1], time = 0.0;
    State state[PHASES + 1];
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

/* Divide the fractions of two neighbouring parts by their sum if they leave nothing between them, or almost nothing: a
   short phase between longer ones has knots so close that the spline overshoots. */
static void fill(double *first, double *second, double full)
{
    const double sum = *first + *second > full ? *first + *second : 1.0;
    *first /= sum;
    *second /= sum;
}

/* Scale the fractions of a shape by factors, (6,). */
static Shape varied(Shape shape, const double *factor)
{
    const double min_fraction = 0.02, max_fraction = 0.9;
    double *fraction[] = {&shape.start, &shape.start_jerk, &shape.start_inner,
                          &shape.end,   &shape.end_jerk,   &shape.end_inner};
    for (int i = 0; i < 6; i++)
        *fraction[i] = clamp(*fraction[i] * factor[i], min_fraction, max_fraction);
    fill(&shape.start, &shape.end, 0.98);
    fill(&shape.start_jerk, &shape.start_inner, 0.95);
    fill(&shape.end_jerk, &shape.end_inner, 0.95);
    return shape;
}

/* Search the fastest shape along a path coordinate; return its duration [s].

   First a grid of symmetric shapes, then random variations of the six fractions of the best one, always the same.

   max_time: least duration along another coordinate [s]. A grid that is much slower is not varied: infinity. */
static double best_shape(const Path *path, const Measures *measures, int64_t coordinate, Shape *best, double max_time)
{
    static const double ramps[] = {0.5, 0.42, 0.34, 0.25, 0.17, 0.1}, jerks[] = {0.5, 0.35, 0.2, 0.08};
    enum { ROUNDS = 8, TRIES = 48 };
    const double worth_varying = 1.05; /* largest ratio of the grid's fastest shape to `max_time` */
    double min_time = max_time * worth_varying;
    for (size_t r = 0; r < sizeof ramps / sizeof *ramps; r++)
        for (size_t j = 0; j < sizeof jerks / sizeof *jerks; j++) {
            const Shape candidate = {ramps[r], jerks[j], jerks[j], ramps[r], jerks[j], jerks[j]};
            const double time = shape_time(path, measures, coordinate, candidate, min_time);
            if (time < min_time * (1.0 - 1e-12)) {
                min_time = time;
                *best = candidate;
            }
        }
    if (min_time == max_time * worth_varying)
        return INFINITY;
    /* Factors on ramps and jerk phases in the first round; each following round takes their square roots. Every try
       multiplies, divides or keeps each fraction. */
    double factors[2] = {1.4, 2.5};
    uint32_t random = 1;
    for (int round = 0; round < ROUNDS; round++) {
        for (int k = 0; k < TRIES; k++) {
            double factor[6];
            for (int i = 0; i < 6; i++) {
                random = random * 1664525u + 1013904223u;
                const int up = (int)((random >> 16) % 3) - 1;
                factor[i] = up > 0 ? factors[i % 3 > 0] : up < 0 ? 1.0 / factors[i % 3 > 0] : 1.0;
            }
            const Shape candidate = varied(*best, factor);
            const double time = shape_time(path, measures, coordinate, candidate, min_time);
            if (time < min_time * (1.0 - 1e-12)) {
                min_time = time;
                *best = candidate;
            }
        }
        for (int i = 0; i < 2; i++)
            factors[i] = sqrt(factors[i]);
    }
    return min_time;
}

/* Place at least `min_knots` knots in [0, 1], at the ends of all phases and evenly within; return their number.

   The first and last phase have three or more because the spline's boundary conditions take two knots at each end. */
static int64_t shape_knots(Shape shape, int64_t min_knots, double *time, double *distance)
{
    double boundary[PHASES + 1];
    State state[PHASES + 1];
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
    /* Factors on the times of the coordinates: those of the third, rougher one are too short with few samples. */
    static const double penalty[COORDINATES] = {1.0, 1.0, 1.005};
    Shape shape = {0.5, 0.5, 0.5, 0.5, 0.5, 0.5};
    int64_t coordinate = 0;
    double min_time = INFINITY;
    for (int64_t c = 0; c < COORDINATES; c++) {
        Shape candidate;
        const double time = best_shape(path, &measures, c, &candidate, min_time / penalty[c]) * penalty[c];
        if (time < min_time * (1.0 - 1e-12)) {
            min_time = time;
            shape = candidate;
            coordinate = c;
        }
    }
    const int64_t knots = shape_knots(shape, min_knots, motion->time, distance);
    const double *fraction = measures.fraction + coordinate * path->samples;
    const int failed = spline_along_path(path, fraction, distance, knots, NULL, *motion);
    free_measures(&measures);
    free(distance);
    return failed ? 0 : knots;
}
