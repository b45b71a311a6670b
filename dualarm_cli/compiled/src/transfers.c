/* Transfers of several joints, each by phases of constant jerk of its own, as knots that they share. */

#include "paths.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>

/* Knots nearer than this are one knot [s]. */
static const double SAME_TIME = 1e-9;

typedef struct {
    const double *start, *leaving, *goal, *arriving; /* positions, (joints,), velocities and accelerations, (2, joints) */
    const double *limit;                             /* of the jerk, (joints,); infinite: accelerations may jump */
    const double *length, *acceleration, *jerk;      /* of the phases, at their starts and throughout, (joints, 7) */
    double duration;                                 /* when every motion ends */
    int64_t joints;
} Transfer;

typedef struct {
    double edge[PHASES + 1];  /* starts of the phases, and the end */
    State state[PHASES + 1]; /* there; positions in place of ways */
} Course;

static int ascending(const void *one, const void *other)
{
    const double a = *(const double *)one, b = *(const double *)other;
    return (a > b) - (a < b);
}

static Course course_of(const Transfer *asked, int64_t joint)
{
    Course own;
    const double *length = asked->length + joint * PHASES, *a = asked->acceleration + joint * PHASES;
    const double *j = asked->jerk + joint * PHASES;
    const int64_t n = asked->joints;
    double q = asked->start[joint], v = asked->leaving[joint];
    own.edge[0] = 0.0;
    for (int p = 0; p < PHASES; p++) {
        own.state[p] = (State){q, v, a[p], j[p]};
        const State end = advanced(own.state[p], length[p]);
        q = end.way;
        v = end.speed;
        own.edge[p + 1] = own.edge[p] + length[p];
    }
    own.state[PHASES] = (State){asked->goal[joint], asked->arriving[joint], asked->arriving[n + joint], 0.0};
    /* Every motion ends at one instant exactly; phases of no length end there with it. */
    const double end = own.edge[PHASES];
    for (int p = 0; end > 0.0 && p <= PHASES; p++)
        own.edge[p] = own.edge[p] >= end ? asked->duration : own.edge[p];
    return own;
}

/* The state at an instant, in the phase of the instant moved by `shift`. */
static State state_at(const Course *own, double time, double shift)
{
    int p = 0;
    while (p < PHASES && own->edge[p + 1] <= time + shift)
        p++;
    const double dt = time - own->edge[p];
    State found = advanced(own->state[p], dt);
    /* A knot that stands in for the beginning of a phase a moment later has that phase's velocity and acceleration: led
       back along the phase, they could exceed their limits. */
    if (dt < 0.0) {
        found.speed = own->state[p].speed;
        found.acceleration = own->state[p].acceleration;
    }
    return found;
}

static void put(const Motion *found, int64_t n, int64_t knot, int64_t joint, State state)
{
    found->position[knot * n + joint] = state.way;
    found->velocity[knot * n + joint] = state.speed;
    found->acceleration[knot * n + joint] = state.acceleration;
}

/* Writes a transfer's knots, 2 (8 joints + 2) of them at most: ends of all joints' phases, the last one exactly the goal.
   Only accelerations of joints without a jerk limit jump, at two knots at one time. Returns how many, or 0 without
   memory. */
int64_t transfer_knots(const Transfer *asked, const Motion *found)
{
    const int64_t n = asked->joints, many = (PHASES + 1) * n + 2;
    Course *course = malloc(sizeof(Course) * (size_t)n);
    double *edge = malloc(sizeof(double) * (size_t)many);
    int64_t instants = 0, knots = 0;
    if (!course || !edge) {
        free(course);
        free(edge);
        return 0;
    }
    for (int64_t k = 0; k < n; k++) {
        course[k] = course_of(asked, k);
        for (int p = 0; p <= PHASES; p++)
            edge[k * (PHASES + 1) + p] = course[k].edge[p];
    }
    edge[many - 2] = 0.0;
    edge[many - 1] = asked->duration;
    qsort(edge, (size_t)many, sizeof(double), ascending);
    /* The end is exact, whatever came shortly before it. */
    const double end = edge[many - 1];
    for (int64_t i = 0; i < many; i++)
        if (instants == 0 || edge[i] - edge[instants - 1] > SAME_TIME)
            edge[instants++] = edge[i];
    edge[instants - 1] = end;
    for (int64_t i = 0; i < instants; i++) {
        const double time = edge[i];
        int jump = 0;
        for (int64_t k = 0; k < n; k++) {
            const State after = state_at(course + k, time, SAME_TIME);
            put(found, n, knots, k, after);
            if (!isinf(asked->limit[k]))
                continue;
            /* Before its first knot every joint is as the problem says. */
            const double before = i ? state_at(course + k, time, -SAME_TIME).acceleration : asked->leaving[n + k];
            jump |= before != after.acceleration;
        }
        found->time[knots++] = time;
        if (!jump)
            continue;
        for (int64_t k = 0; k < n; k++) {
            const State after = state_at(course + k, time, SAME_TIME);
            State before = i ? state_at(course + k, time, -SAME_TIME) : after;
            if (!i)
                before = (State){asked->start[k], asked->leaving[k], asked->leaving[n + k], 0.0};
            put(found, n, knots, k, after);
            if (isinf(asked->limit[k]) && before.acceleration != after.acceleration)
                put(found, n, knots - 1, k, before);
        }
        found->time[knots++] = time;
    }
    free(course);
    free(edge);
    return knots;
}

/* Whether phases stay between positions, from their lengths and positions, velocities, accelerations and jerks at their
   starts, (joints, 5, 7): at the starts and where the velocity is none. */
int stays_between(const double *phases, const double *lower, const double *upper, int64_t joints)
{
    for (int64_t k = 0; k < joints; k++)
        for (int p = 0; p < PHASES; p++) {
            const double *at = phases + k * 5 * PHASES + p;
            const State from = {at[PHASES], at[2 * PHASES], at[3 * PHASES], at[4 * PHASES]};
            const double v = from.speed, a = from.acceleration, j = from.jerk;
            /* v + a t + j t^2 / 2 = 0, in the form that divides by neither a small j nor a small difference. */
            const double root = sqrt(larger(a * a - 2.0 * j * v, 0.0)), large = -(a + (a < 0.0 ? -root : root));
            const double turn[2] = {j != 0.0 ? large / j : 0.0, large != 0.0 ? 2.0 * v / large : 0.0};
            for (int i = 0; i < 2; i++) {
                const double q = advanced(from, turn[i] > 0.0 && turn[i] < at[0] ? turn[i] : 0.0).way;
                if (!(q >= lower[k] && q <= upper[k]))
                    return 0;
            }
        }
    return 1;
}
