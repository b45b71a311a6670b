/* Deviation of a tool from the straight line between two postures of its arm. */

#include "paths.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>

typedef struct {
    const double *steps;   /* poses [R p] of each joint at zero in its parent, and of the flange in the last joint,
                              (joints + 1, 3, 4) */
    const uint8_t *slides; /* 1 for joints that slide along their z axes, 0 for those that turn about them, (joints,) */
    const double *tip;     /* tool tip in the flange frame [m], (3,) */
    int64_t joints;
} Chain;

/* Flange rotation and position of the tool tip [m]. */
typedef struct {
    double R[3][3], tip[3];
} Pose;

/* Multiply the pose (R, p) by a step's pose in place. */
static void apply_step(double R[3][3], double p[3], const double *step)
{
    for (int i = 0; i < 3; i++) {
        const double x = R[i][0], y = R[i][1], z = R[i][2];
        p[i] += x * step[3] + y * step[7] + z * step[11];
        for (int j = 0; j < 3; j++)
            R[i][j] = x * step[j] + y * step[4 + j] + z * step[8 + j];
    }
}

/* Compute the forward kinematics of a posture. */
static Pose forward_kinematics(const Chain *chain, const double *q)
{
    Pose pose = {{{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}}, {0.0, 0.0, 0.0}};
    for (int64_t k = 0; k < chain->joints; k++) {
        apply_step(pose.R, pose.tip, chain->steps + 12 * k);
        const double c = cos(q[k]), s = sin(q[k]);
        for (int i = 0; i < 3; i++) {
            const double x = pose.R[i][0], y = pose.R[i][1];
            if (chain->slides[k]) {
                pose.tip[i] += q[k] * pose.R[i][2];
                continue;
            }
            pose.R[i][0] = c * x + s * y;
            pose.R[i][1] = c * y - s * x;
        }
    }
    apply_step(pose.R, pose.tip, chain->steps + 12 * chain->joints);
    for (int i = 0; i < 3; i++)
        pose.tip[i] += pose.R[i][0] * chain->tip[0] + pose.R[i][1] * chain->tip[1] + pose.R[i][2] * chain->tip[2];
    return pose;
}

/* Compute the largest deviation of a motion from the line between two postures, at `parts` instants per interval.

   ends: the two postures, (2, joints). distance: of the tip from the line [m]. angle: of the flange from its first
   orientation [rad]. Returns 0, or 1 if out of memory. */
int line_deviation(const Chain *chain, const double *ends, const Motion *motion, int64_t knots, int64_t parts,
                   double *distance, double *angle)
{
    const int64_t n = chain->joints;
    double *q = malloc(sizeof(double) * (size_t)n), direction[3], length = 0.0;
    double max_squared_distance = 0.0, max_squared_rotation = 0.0;
    if (!q)
        return 1;
    const Pose first = forward_kinematics(chain, ends), last = forward_kinematics(chain, ends + n);
    for (int i = 0; i < 3; i++) {
        direction[i] = last.tip[i] - first.tip[i];
        length += direction[i] * direction[i];
    }
    /* A line of zero length has no direction: the whole distance counts as deviation. */
    length = length > 0.0 ? sqrt(length) : INFINITY;
    for (int64_t k = 0; k + 1 < knots; k++) {
        const double h = motion->time[k + 1] - motion->time[k];
        for (int64_t part = 0; part < parts; part++) {
            for (int64_t joint = 0; joint < n; joint++) {
                const double before = motion->acceleration[k * n + joint];
                const double after = motion->acceleration[(k + 1) * n + joint];
                const State from = {motion->position[k * n + joint], motion->velocity[k * n + joint], before,
                                    h > 0.0 ? (after - before) / h : 0.0};
                q[joint] = advance(from, h * ((double)part / (double)parts)).position;
            }
            const Pose pose = forward_kinematics(chain, q);
            double along_line = 0.0, squared_distance = 0.0, squared_rotation = 0.0;
            for (int i = 0; i < 3; i++)
                along_line += (pose.tip[i] - first.tip[i]) * direction[i] / length;
            for (int i = 0; i < 3; i++) {
                const double offset = pose.tip[i] - first.tip[i] - along_line * direction[i] / length;
                squared_distance += offset * offset;
                for (int j = 0; j < 3; j++)
                    squared_rotation += (pose.R[i][j] - first.R[i][j]) * (pose.R[i][j] - first.R[i][j]);
            }
            /* NaN counts as an infinite deviation. */
            max_squared_distance = larger(isnan(squared_distance) ? INFINITY : squared_distance, max_squared_distance);
            max_squared_rotation = larger(isnan(squared_rotation) ? INFINITY : squared_rotation, max_squared_rotation);
        }
    }
    *distance = sqrt(max_squared_distance);
    /* |R - R0| in the Frobenius norm is 2 sqrt(2) sin(angle/2), which loses no digits near zero. */
    *angle = 2.0 * asin(clamp(sqrt(max_squared_rotation / 8.0), 0.0, 1.0));
    free(q);
    return 0;
}
