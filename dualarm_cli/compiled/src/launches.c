/* Launches: profiles of a line from rest that pass its far end in motion. Method: timing/launch.py. */

#include "paths.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>

/* Parameters of a launch profile, as in `Launch` of timing/launch.py. */
typedef struct {
    double constant, cruise, inner, cut;
} Launch;

/* Compute the phase durations and states of a launch, scaled to distance 1 in time 1.

   length: durations, which sum to 1, (7,). state: states at the starts of the phases and at the end, (8,). */
static void launch_phases(Launch launch, double *length, State *state)
{
    const double ramp = 1.0 + launch.constant + 1.0 / launch.inner;
    const double full_length[PHASES] = {1.0, launch.constant, 1.0 / launch.inner, launch.cruise * ramp,
                                        1.0 / launch.inner, launch.constant, 1.0};
    const double jerk[PHASES] = {1.0, 0.0, -launch.inner, 0.0, -launch.inner, 0.0, 1.0};
    const double cut_length = launch.cut * (2.0 + launch.cruise) * ramp;
    double end = 0.0, sum = 0.0;
    for (int p = 0; p < PHASES; p++) {
        end += full_length[p];
        length[p] = clamp(full_length[p] - (end - cut_length), 0.0, full_length[p]);
        sum += length[p];
    }
    for (int p = 0; p < PHASES; p++)
        length[p] /= sum;
    states_of_phases(length, jerk, state);
}

/* Compute the least duration of a launch along a path coordinate [s].

   Limits are checked at both ends of each phase and at instants in between, more of them in longer phases. */
static double launch_time(const Path *path, const Measures *measures, int64_t coordinate, const double *length,
                          const State *state)
{
    enum { CHECKS = 16 }; /* checked instants over the whole duration */
    Peaks peaks = start_peaks(path, measures, coordinate);
    for (int p = 0; p < PHASES; p++) {
        if (!(length[p] > 0.0))
            continue;
        const int parts = (int)(length[p] * CHECKS) + 1;
        for (int i = 0; i <= parts; i++) {
            State at = advance(state[p], length[p] * (rint(CHECKS * (double)i / parts) / CHECKS));
            at.position = clamp(at.position, 0.0, 1.0);
            add_state(&peaks, at);
        }
    }
    return min_duration(&peaks);
}

/* Select the path coordinate with the shortest duration of a launch. */
static int64_t fastest_coordinate(const Path *path, const Measures *measures, Launch launch)
{
    enum { CANDIDATES = 2 }; /* the third is too rough for profiles that are fastest at their end */
    double length[PHASES], min_time = INFINITY;
    State state[PHASES + 1];
    int64_t fastest = 0;
    launch_phases(launch, length, state);
    for (int64_t c = 0; c < CANDIDATES; c++) {
        const double time = launch_time(path, measures, c, length, state);
        if (time < min_time) {
            min_time = time;
            fastest = c;
        }
    }
    return fastest;
}

/* Estimate the duration [s] of a launch along a path coordinate, and joint velocities and accelerations at its end,
   (joints,). */
static double estimate_launch(const Path *path, const Measures *measures, int64_t coordinate, Launch launch,
                              double *velocity, double *acceleration)
{
    double length[PHASES];
    State state[PHASES + 1];
    launch_phases(launch, length, state);
    const double time = launch_time(path, measures, coordinate, length, state) * ROUNDING;
    const double end_speed = state[PHASES].speed, end_acceleration = state[PHASES].acceleration;
    const int64_t n = path->joints, m = path->samples, s = measures->stride;
    const double *q1 = measures->rates + (coordinate * m + m - 1) * 3 * s, *q2 = q1 + s;
    for (int64_t k = 0; k < n; k++) {
        velocity[k] = q1[k] * end_speed / time;
        acceleration[k] = (q2[k] * end_speed * end_speed + q1[k] * end_acceleration) / (time * time);
    }
    return time;
}

/* Estimate launches of one line: every profile with every cut.

   profiles: constant, cruise and inner of each, (count, 3). cuts: (cut_count,). compared: the cut at which coordinates
   are compared.
   coordinate: fastest path coordinate of each profile, (count,). time: durations [s], (count, cut_count). velocity,
   acceleration: of the joints at the far end, (count, cut_count, joints).
   Returns 0, or 1 if out of memory. */
int launches(const Path *path, const double *profiles, int64_t count, const double *cuts, int64_t cut_count,
             double compared, int64_t *coordinate, double *time, double *velocity, double *acceleration)
{
    Measures measures;
    if (measure_path(path, &measures))
        return 1;
    const int64_t n = path->joints;
    for (int64_t p = 0; p < count; p++) {
        Launch launch = {profiles[3 * p], profiles[3 * p + 1], profiles[3 * p + 2], compared};
        coordinate[p] = fastest_coordinate(path, &measures, launch);
        for (int64_t i = p * cut_count; i < (p + 1) * cut_count; i++) {
            launch.cut = cuts[i - p * cut_count];
            time[i] = estimate_launch(path, &measures, coordinate[p], launch, velocity + i * n, acceleration + i * n);
        }
    }
    free_measures(&measures);
    return 0;
}

/* Estimate launches of several lines, each with its own profiles and cuts.

   first: the first line; the others follow in memory with the same number of samples. profiles: (lines, per_line, 3).
   cuts: (lines, per_line). compared, coordinate, time, velocity, acceleration: see `launches`, for each line.
   Returns 0, or 1 if out of memory. */
int launched_lines(const Path *first, int64_t lines, int64_t per_line, const double *profiles, const double *cuts,
                   double compared, int64_t *coordinate, double *time, double *velocity, double *acceleration)
{
    Path path = *first;
    Measures measures;
    const int64_t n = path.joints;
    for (int64_t line = 0; line < lines; line++) {
        path.position = first->position + line * path.samples * n;
        if (measure_path(&path, &measures))
            return 1;
        for (int64_t i = line * per_line; i < (line + 1) * per_line; i++) {
            Launch launch = {profiles[3 * i], profiles[3 * i + 1], profiles[3 * i + 2], compared};
            coordinate[i] = fastest_coordinate(&path, &measures, launch);
            launch.cut = cuts[i];
            time[i] = estimate_launch(&path, &measures, coordinate[i], launch, velocity + i * n, acceleration + i * n);
        }
        free_measures(&measures);
    }
    return 0;
}

/* Place about `target_knots` knots in [0, 1], at most 16 more; return their number.

   Ends of phases are knots except for very short phases. The first phase has its own knots however short it is: without
   them the spline's acceleration overshoots by up to two thirds as it rises from rest, which lengthens the line. */
static int64_t launch_knots(const double *length, const State *state, int64_t target_knots, double *time,
                            double *distance)
{
    const double min_length = 0.1; /* shortest phase with its own knots, in mean knot intervals */
    double begin = 0.0;
    int64_t knots = 1;
    time[0] = distance[0] = 0.0;
    for (int p = 0; p < PHASES; p++) {
        if (p == 0 || length[p] * (double)target_knots > min_length) {
            /* The spline's boundary condition takes the first two knots. */
            const int64_t min_parts = p ? 1 : 3, proportional = (int64_t)rint(length[p] * (double)target_knots);
            const int64_t parts = proportional < min_parts ? min_parts : proportional;
            for (int64_t i = 1; i <= parts; i++) {
                const double dt = length[p] * ((double)i / (double)parts);
                time[knots] = begin + dt;
                distance[knots++] = clamp(advance(state[p], dt).position, 0.0, 1.0);
            }
        }
        begin += length[p];
    }
    time[knots - 1] = distance[knots - 1] = 1.0;
    return knots;
}

/* Time a launch along a line with about `target_knots` knots; return their number, or 0 if out of memory. */
int64_t launched_line(const Path *path, const Launch *launch, int64_t coordinate, int64_t target_knots,
                      const Motion *motion)
{
    Measures measures;
    double length[PHASES], *distance = malloc(sizeof(double) * (size_t)(target_knots + 16 + path->joints));
    State state[PHASES + 1];
    if (!distance || measure_path(path, &measures)) {
        free(distance);
        return 0;
    }
    const int64_t m = path->samples, n = path->joints;
    double *end_velocity = distance + target_knots + 16;
    launch_phases(*launch, length, state);
    const int64_t knots = launch_knots(length, state, target_knots, motion->time, distance);
    for (int64_t k = 0; k < n; k++)
        end_velocity[k] = measures.rates[(coordinate * m + m - 1) * 3 * measures.stride + k] * state[PHASES].speed;
    const double *fraction = measures.fraction + coordinate * m;
    const int failed = spline_along_path(path, fraction, distance, knots, end_velocity, *motion);
    free_measures(&measures);
    free(distance);
    return failed ? 0 : knots;
}
