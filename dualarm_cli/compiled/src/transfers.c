/* Transfers: phases of constant jerk for each joint, converted to knots common to all joints. */

#include "paths.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>

/* Largest time difference of knots that are merged [s]. */
static const double TIME_TOLERANCE = 1e-9;

/* Transfer of all joints, each by its own phases of constant jerk. */
typedef struct {
    const double *start, *start_rates; /* positions, (joints,), and velocities and accelerations, (2, joints) */
    const double *goal, *goal_rates;   /* the same at the goal */
    const double *jerk_limit;          /* (joints,); infinite: the joint's acceleration may jump */
    const double *length, *acceleration, *jerk; /* durations, accelerations at the starts, and jerks, (joints, 7) */
    double duration;                            /* of all joints [s] */
    int64_t joints;
} Transfer;

/* Phases of one joint. */
typedef struct {
    double boundary[PHASES + 1]; /* starts of the phases, and the end [s] */
    State state[PHASES + 1];     /* at the boundaries */
} JointPhases;

static int ascending(const void *first, const void *second)
{
    const double a = *(const double *)first, b = *(const double *)second;
    return (a > b) - (a < b);
}

/* Integrate the phases of a joint. */
static JointPhases integrate_phases(const Transfer *transfer, int64_t joint)
{
    JointPhases phases;
    const double *length = transfer->length + joint * PHASES, *a = transfer->acceleration + joint * PHASES;
    const double *j = transfer->jerk + joint * PHASES;
    const int64_t n = transfer->joints;
    double q = transfer->start[joint], v = transfer->start_rates[joint];
    phases.boundary[0] = 0.0;
    for (int p = 0; p < PHASES; p++) {
        phases.state[p] = (State){q, v, a[p], j[p]};
        const State end = advance(phases.state[p], length[p]);
        q = end.position;
        v = end.speed;
        phases.boundary[p + 1] = phases.boundary[p] + length[p];
    }
    phases.state[PHASES] = (State){transfer->goal[joint], transfer->goal_rates[joint],
                                   transfer->goal_rates[n + joint], 0.0};
    /* All joints end at exactly the same instant, and so do their last phases of zero duration. */
    const double end = phases.boundary[PHASES];
    for (int p = 0; end > 0.0 && p <= PHASES; p++)
        phases.boundary[p] = phases.boundary[p] >= end ? transfer->duration : phases.boundary[p];
    return phases;
}

/* Evaluate the state of a joint at `time`, in the phase that holds `time` + `shift`. */
static State state_at(const JointPhases *phases, double time, double shift)
{
    int p = 0;
    while (p < PHASES && phases->boundary[p + 1] <= time + shift)
        p++;
    const double dt = time - phases->boundary[p];
    State state = advance(phases->state[p], dt);
    /* A knot merged with a phase that starts slightly later takes that phase's initial velocity and acceleration:
       extrapolated back along the phase, they could exceed their limits. */
    if (dt < 0.0) {
        state.speed = phases->state[p].speed;
        state.acceleration = phases->state[p].acceleration;
    }
    return state;
}

/* Write the state of a joint at a knot. */
static void put_knot(const Motion *motion, int64_t n, int64_t knot, int64_t joint, State state)
{
    motion->position[knot * n + joint] = state.position;
    motion->velocity[knot * n + joint] = state.speed;
    motion->acceleration[knot * n + joint] = state.acceleration;
}

/* Write the knots of a transfer, at most 2 (8 joints + 2); return their number, or 0 if out of memory.

   Knots are the ends of all joints' phases, the last one exactly the goal. Accelerations of joints without a jerk limit
   may jump: there are two knots at the same time. */
int64_t transfer_knots(const Transfer *transfer, const Motion *motion)
{
    const int64_t n = transfer->joints, count = (PHASES + 1) * n + 2;
    JointPhases *phases = malloc(sizeof(JointPhases) * (size_t)n);
    double *instant = malloc(sizeof(double) * (size_t)count);
    int64_t instants = 0, knots = 0;
    if (!phases || !instant) {
        free(phases);
        free(instant);
        return 0;
    }
    for (int64_t k = 0; k < n; k++) {
        phases[k] = integrate_phases(transfer, k);
        for (int p = 0; p <= PHASES; p++)
            instant[k * (PHASES + 1) + p] = phases[k].boundary[p];
    }
    instant[count - 2] = 0.0;
    instant[count - 1] = transfer->duration;
    qsort(instant, (size_t)count, sizeof(double), ascending);
    /* The end is exact even if a knot shortly before it is merged with it. */
    const double end = instant[count - 1];
    for (int64_t i = 0; i < count; i++)
        if (instants == 0 || instant[i] - instant[instants - 1] > TIME_TOLERANCE)
            instant[instants++] = instant[i];
    instant[instants - 1] = end;
    for (int64_t i = 0; i < instants; i++) {
        const double time = instant[i];
        int jumps = 0;
        for (int64_t k = 0; k < n; k++) {
            const State after = state_at(phases + k, time, TIME_TOLERANCE);
            put_knot(motion, n, knots, k, after);
            if (!isinf(transfer->jerk_limit[k]))
                continue;
            /* Before the first knot every joint has the accelerations at the start of the transfer. */
            const double before =
                i ? state_at(phases + k, time, -TIME_TOLERANCE).acceleration : transfer->start_rates[n + k];
            jumps |= before != after.acceleration;
        }
        motion->time[knots++] = time;
        if (!jumps)
            continue;
        for (int64_t k = 0; k < n; k++) {
            const State after = state_at(phases + k, time, TIME_TOLERANCE);
            State before = i ? state_at(phases + k, time, -TIME_TOLERANCE) : after;
            if (!i)
                before = (State){transfer->start[k], transfer->start_rates[k], transfer->start_rates[n + k], 0.0};
            put_knot(motion, n, knots, k, after);
            if (isinf(transfer->jerk_limit[k]) && before.acceleration != after.acceleration)
                put_knot(motion, n, knots - 1, k, before);
        }
        motion->time[knots++] = time;
    }
    free(phases);
    free(instant);
    return knots;
}

/* Check whether all phases stay within position limits, at their starts and where the velocity is zero.

   phases: durations, and positions, velocities, accelerations and jerks at the starts, (joints, 5, 7).
   lower, upper: position limits, (joints,). */
int stays_between(const double *phases, const double *lower, const double *upper, int64_t joints)
{
    for (int64_t k = 0; k < joints; k++)
        for (int p = 0; p < PHASES; p++) {
            const double *phase = phases + k * 5 * PHASES + p;
            const State from = {phase[PHASES], phase[2 * PHASES], phase[3 * PHASES], phase[4 * PHASES]};
            const double v = from.speed, a = from.acceleration, j = from.jerk;
            /* v + a t + j t^2 / 2 = 0, in the form that divides by neither a small j nor a small difference. */
            const double root = sqrt(larger(a * a - 2.0 * j * v, 0.0)), sum = -(a + (a < 0.0 ? -root : root));
            const double t[2] = {j != 0.0 ? sum / j : 0.0, sum != 0.0 ? 2.0 * v / sum : 0.0};
            for (int i = 0; i < 2; i++) {
                const double q = advance(from, t[i] > 0.0 && t[i] < phase[0] ? t[i] : 0.0).position;
                if (!(q >= lower[k] && q <= upper[k]))
                    return 0;
            }
        }
    return 1;
}
