/* How far a tool leaves the straight line between two postures of its arm. */

#include "paths.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>

typedef struct {
    const double *steps;   /* rotation and position of each joint at zero in the one before, of the flange in the last
                              one, (joints + 1, 3, 4) */
    const uint8_t *slides; /* joints that slide along their z axes, (joints,); the others turn about them */
    const double *tip;     /* of the tool in the flange, (3,) */
    int64_t joints;
} Chain;

/* Flange rotation, row by row, and place of the tip. */
typedef struct {
    double R[3][3], tip[3];
} Pose;

/* R times a step's rotation, and p moved by its position. */
static void take_step(double R[3][3], double p[3], const double *step)
{
    for (int i = 0; i < 3; i++) {
        const double x = R[i][0], y = R[i][1], z = R[i][2];
        p[i] += x * step[3] + y * step[7] + z * step[11];
        for (int j = 0; j < 3; j++)
            R[i][j] = x * step[j] + y * step[4 + j] + z * step[8 + j];
    }
}

static Pose pose_of(const Chain *chain, const double *q)
{
    Pose own = {{{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}}, {0.0, 0.0, 0.0}};
    for (int64_t k = 0; k < chain->joints; k++) {
        take_step(own.R, own.tip, chain->steps + 12 * k);
        const double c = cos(q[k]), s = sin(q[k]);
        for (int i = 0; i < 3; i++) {
            const double x = own.R[i][0], y = own.R[i][1];
            if (chain->slides[k]) {
                own.tip[i] += q[k] * own.R[i][2];
                continue;
            }
            own.R[i][0] = c * x + s * y;
            own.R[i][1] = c * y - s * x;
        }
    }
    take_step(own.R, own.tip, chain->steps + 12 * chain->joints);
    for (int i = 0; i < 3; i++)
        own.tip[i] += own.R[i][0] * chain->tip[0] + own.R[i][1] * chain->tip[1] + own.R[i][2] * chain->tip[2];
    return own;
}

/* Distance of the tip from the line between those of two postures, (2, joints), and angle of the flange to its first one:
   the largest at `parts` instants of each interval of a motion. Returns 0, or 1 without memory. */
int line_deviation(const Chain *chain, const double *ends, const Motion *motion, int64_t knots, int64_t parts,
                   double *distance, double *angle)
{
    const int64_t n = chain->joints;
    double *q = malloc(sizeof(double) * (size_t)n), direction[3], length = 0.0, farthest = 0.0, widest = 0.0;
    if (!q)
        return 1;
    const Pose first = pose_of(chain, ends), last = pose_of(chain, ends + n);
    for (int i = 0; i < 3; i++) {
        direction[i] = last.tip[i] - first.tip[i];
        length += direction[i] * direction[i];
    }
    /* Without length there is no direction: all of the distance is beside the line. */
    length = length > 0.0 ? sqrt(length) : INFINITY;
    for (int64_t k = 0; k + 1 < knots; k++) {
        const double h = motion->time[k + 1] - motion->time[k];
        for (int64_t part = 0; part < parts; part++) {
            for (int64_t joint = 0; joint < n; joint++) {
                const double a = motion->acceleration[k * n + joint], after = motion->acceleration[(k + 1) * n + joint];
                const State from = {motion->position[k * n + joint], motion->velocity[k * n + joint], a,
                                    h > 0.0 ? (after - a) / h : 0.0};
                q[joint] = advanced(from, h * ((double)part / (double)parts)).way;
            }
            const Pose here = pose_of(chain, q);
            double along = 0.0, beside = 0.0, turned = 0.0;
            for (int i = 0; i < 3; i++)
                along += (here.tip[i] - first.tip[i]) * direction[i] / length;
            for (int i = 0; i < 3; i++) {
                const double off = here.tip[i] - first.tip[i] - along * direction[i] / length;
                beside += off * off;
                for (int j = 0; j < 3; j++)
                    turned += (here.R[i][j] - first.R[i][j]) * (here.R[i][j] - first.R[i][j]);
            }
            /* What is no number is nowhere near the line. */
            farthest = larger(isnan(beside) ? INFINITY : beside, farthest);
            widest = larger(isnan(turned) ? INFINITY : turned, widest);
        }
    }
    *distance = sqrt(farthest);
    /* |R - R0| in the Frobenius norm is 2 sqrt(2) sin(angle/2); no loss of digits near zero. */
    *angle = 2.0 * asin(within(sqrt(widest / 8.0), 0.0, 1.0));
    free(q);
    return 0;
}
