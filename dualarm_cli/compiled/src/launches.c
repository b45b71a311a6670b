/* Profiles that pass a line's far end in motion; the method is explained in timing/launch.py. */

#include "paths.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>

/* Constant, cruise, inner and cut of timing/launch.py's `Launch`. */
typedef struct {
    double constant, cruise, inner, cut;
} Launch;

/* Returns lengths, which sum up to 1, of the phases, (7,), and the states at their starts, scaled to way 1; the eighth is
   the end. */
static void launch_phases(Launch launch, double *length, State *state)
{
    const double ramp = 1.0 + launch.constant + 1.0 / launch.inner;
    const double whole[PHASES] = {1.0, launch.constant, 1.0 / launch.inner, launch.cruise * ramp, 1.0 / launch.inner,
                                  launch.constant, 1.0};
    const double jerk[PHASES] = {1.0, 0.0, -launch.inner, 0.0, -launch.inner, 0.0, 1.0};
    const double over = launch.cut * (2.0 + launch.cruise) * ramp;
    double until = 0.0, sum = 0.0;
    for (int p = 0; p < PHASES; p++) {
        until += whole[p];
        length[p] = within(whole[p] - (until - over), 0.0, whole[p]);
        sum += length[p];
    }
    State at = {0.0, 0.0, 0.0, 0.0};
    for (int p = 0; p < PHASES; p++) {
        length[p] /= sum;
        /* A phase of no length has no jerk. */
        at.jerk = length[p] > 0.0 ? jerk[p] : 0.0;
        state[p] = at;
        at = advanced(at, length[p]);
    }
    state[PHASES] = at;
    for (int p = 0; p <= PHASES; p++)
        state[p] = (State){state[p].way / at.way, state[p].speed / at.way, state[p].acceleration / at.way,
                           state[p].jerk / at.way};
}

/* How long a profile must take: both ends of each phase count and instants between them, the longer the more. */
static double launch_time(const Path *path, const Measures *measures, int64_t coordinate, const double *length,
                          const State *state)
{
    enum { BETWEEN = 16 }; /* so many instants between ends of phases in the whole time */
    Needs needs = needs_of(path, measures, coordinate);
    for (int p = 0; p < PHASES; p++) {
        if (!(length[p] > 0.0))
            continue;
        const int parts = (int)(length[p] * BETWEEN) + 1;
        for (int i = 0; i <= parts; i++) {
            State at = advanced(state[p], length[p] * (rint(BETWEEN * (double)i / parts) / BETWEEN));
            at.way = within(at.way, 0.0, 1.0);
            look(&needs, at);
        }
    }
    return needed_time(&needs);
}

/* Returns the path coordinate along which a profile with some cut is the fastest. */
static int64_t fastest_coordinate(const Path *path, const Measures *measures, Launch launch)
{
    enum { TRIED = 2 }; /* the others are too rough where the speed is greatest at the end */
    double length[PHASES], least = INFINITY;
    State state[PHASES + 1];
    int64_t fastest = 0;
    launch_phases(launch, length, state);
    for (int64_t c = 0; c < TRIED; c++) {
        const double own = launch_time(path, measures, c, length, state);
        if (own < least) {
            least = own;
            fastest = c;
        }
    }
    return fastest;
}

/* Estimates a profile along a path coordinate: how long it takes, and velocities and accelerations at the end, (joints,). */
static double estimate(const Path *path, const Measures *measures, int64_t coordinate, Launch launch, double *velocity,
                       double *acceleration)
{
    double length[PHASES];
    State state[PHASES + 1];
    launch_phases(launch, length, state);
    const double time = launch_time(path, measures, coordinate, length, state) * ROUNDING;
    const double speed = state[PHASES].speed, gain = state[PHASES].acceleration;
    const int64_t n = path->joints, m = path->samples, s = measures->stride;
    const double *first = measures->rates + (coordinate * m + m - 1) * 3 * s, *second = first + s;
    for (int64_t k = 0; k < n; k++) {
        velocity[k] = first[k] * speed / time;
        acceleration[k] = (second[k] * speed * speed + first[k] * gain) / (time * time);
    }
    return time;
}

/* Estimates profiles of a line that pass its far end, each with all cuts: time, (profiles, cuts), velocities and
   accelerations at the end, (profiles, cuts, joints), and the coordinate along which each profile is the fastest with the
   cut `compared`, (profiles,). Returns 0, or 1 without memory. */
int launches(const Path *path, const double *profiles, int64_t count, const double *cuts, int64_t many, double compared,
             int64_t *coordinate, double *time, double *velocity, double *acceleration)
{
    Measures measures;
    if (measure(path, &measures))
        return 1;
    const int64_t n = path->joints;
    for (int64_t p = 0; p < count; p++) {
        Launch launch = {profiles[3 * p], profiles[3 * p + 1], profiles[3 * p + 2], compared};
        coordinate[p] = fastest_coordinate(path, &measures, launch);
        for (int64_t i = p * many; i < (p + 1) * many; i++) {
            launch.cut = cuts[i - p * many];
            time[i] = estimate(path, &measures, coordinate[p], launch, velocity + i * n, acceleration + i * n);
        }
    }
    release(&measures);
    return 0;
}

/* Estimates many lines of as many samples, which follow one another from `first`, each with profiles, (lines, each, 3),
   and cuts, (lines, each), of its own: coordinates and times, (lines, each), velocities and accelerations at the far ends,
   (lines, each, joints). Returns 0, or 1 without memory. */
int launched_lines(const Path *first, int64_t lines, int64_t each, const double *profiles, const double *cuts,
                   double compared, int64_t *coordinate, double *time, double *velocity, double *acceleration)
{
    Path path = *first;
    Measures measures;
    const int64_t n = path.joints;
    for (int64_t line = 0; line < lines; line++) {
        path.position = first->position + line * path.samples * n;
        if (measure(&path, &measures))
            return 1;
        for (int64_t i = line * each; i < (line + 1) * each; i++) {
            Launch launch = {profiles[3 * i], profiles[3 * i + 1], profiles[3 * i + 2], compared};
            coordinate[i] = fastest_coordinate(&path, &measures, launch);
            launch.cut = cuts[i];
            time[i] = estimate(&path, &measures, coordinate[i], launch, velocity + i * n, acceleration + i * n);
        }
        release(&measures);
    }
    return 0;
}

/* About `wanted` knots in [0, 1], ends of all phases but very short ones among them, at most 16 more. The first phase has
   its own however short: without them the spline's acceleration overshoots where it rises from rest, by up to two thirds,
   and the line takes that much longer. Returns how many. */
static int64_t launch_knots(const double *length, const State *state, int64_t wanted, double *time, double *way)
{
    const double shortest = 0.1; /* longest phase without a knot of its own, in mean distances of knots */
    double begin = 0.0;
    int64_t knots = 1;
    time[0] = way[0] = 0.0;
    for (int p = 0; p < PHASES; p++) {
        if (p == 0 || length[p] * (double)wanted > shortest) {
            /* The first two knots belong to the boundary. */
            const int64_t least = p ? 1 : 3, even = (int64_t)rint(length[p] * (double)wanted);
            const int64_t parts = even < least ? least : even;
            for (int64_t i = 1; i <= parts; i++) {
                const double dt = length[p] * ((double)i / (double)parts);
                time[knots] = begin + dt;
                way[knots++] = within(advanced(state[p], dt).way, 0.0, 1.0);
            }
        }
        begin += length[p];
    }
    time[knots - 1] = way[knots - 1] = 1.0;
    return knots;
}

/* Times a line from rest so that it passes its far end in motion, with about `wanted` knots. Returns how many, or 0
   without memory. */
int64_t launched_line(const Path *path, const Launch *launch, int64_t coordinate, int64_t wanted, const Motion *found)
{
    Measures measures;
    double length[PHASES], *way = malloc(sizeof(double) * (size_t)(wanted + 16 + path->joints));
    State state[PHASES + 1];
    if (!way || measure(path, &measures)) {
        free(way);
        return 0;
    }
    const int64_t m = path->samples, n = path->joints;
    double *last = way + wanted + 16;
    launch_phases(*launch, length, state);
    const int64_t knots = launch_knots(length, state, wanted, found->time, way);
    for (int64_t k = 0; k < n; k++)
        last[k] = measures.rates[(coordinate * m + m - 1) * 3 * measures.stride + k] * state[PHASES].speed;
    const int failed = along(path, measures.share + coordinate * m, way, knots, last, *found);
    release(&measures);
    free(way);
    return failed ? 0 : knots;
}
