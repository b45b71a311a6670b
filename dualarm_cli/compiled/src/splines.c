/* Cubic splines through knots, C2 with constant jerk between them, and their exact extrema.

   Arrays over knots and joints are row by row, x[knot * joints + joint]. */

#include "splines.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>

/* Solve the spline through `position` for the accelerations at the knots ([Biagiotti2008] 4.4.1).

   first, last: velocities at the ends, (joints,); null: at rest with zero acceleration. Each end at rest adds one
   condition more than there are unknowns (4.4.4), so the knot next to it is free: `position` is changed there.
   knots: at least 3, 4 with one end at rest, 5 with both.
   Returns 0, or 1 if out of memory. */
int cubic_spline(const double *time, int64_t knots, int64_t joints, const double *first, const double *last,
                 double *position, double *velocity, double *acceleration)
{
    double *const work = malloc(sizeof(double) * (size_t)(3 * knots));
    if (!work)
        return 1;
    double *const step = work, *const pivot = work + knots, *const above = work + 2 * knots;
    const int64_t n = joints, end = knots - 1;
    double *const q = position, *const v = velocity, *const a = acceleration;
    for (int64_t i = 0; i < end; i++)
        step[i] = time[i + 1] - time[i];
    const double h0 = step[0], h1 = step[1], h2 = step[end - 2], h3 = step[end - 1];
    for (int64_t k = 0; k < n; k++) {
        if (!first)
            q[n + k] = q[k];
        if (!last)
            q[(end - 1) * n + k] = q[end * n + k];
    }
    /* The unknowns are the accelerations of the knots from `low` to `high`. Row i is
       h_i-1 a_i-1 + 2 (h_i-1 + h_i) a_i + h_i a_i+1 = 6 (slope_i - slope_i-1), with velocities as end slopes. */
    const int64_t low = first ? 0 : 1, high = last ? end : end - 1;
    for (int64_t i = low; i <= high; i++) {
        const double *const right = q + (i + 1) * n, *const centre = q + i * n, *const left = q + (i - 1) * n;
        pivot[i] = i == 0 ? 2.0 * h0 : i == end ? 2.0 * h3 : 2.0 * (step[i - 1] + step[i]);
        above[i] = i == end ? 0.0 : step[i];
        for (int64_t k = 0; k < n; k++) {
            const double after = i == end ? last[k] : (right[k] - centre[k]) / step[i];
            const double before = i == 0 ? first[k] : (centre[k] - left[k]) / step[i - 1];
            a[i * n + k] = 6.0 * (after - before);
        }
    }
    /* From rest q_1 = q_0 + h_0^2 a_1 / 6, and likewise at the end: the unknown term moves to the left side. */
    double second_below = h1;
    if (!first) {
        pivot[1] += h0 * h0 / h1 + h0;
        second_below -= h0 * h0 / h1;
    }
    if (!last) {
        pivot[end - 1] += h3 * h3 / h2 + h3;
        above[end - 2] -= h3 * h3 / h2;
    }
    /* The Thomas algorithm needs no pivoting because the matrix is diagonally dominant. */
    for (int64_t i = low + 1; i <= high; i++) {
        const double below = i == 2 ? second_below : step[i - 1], factor = below / pivot[i - 1];
        pivot[i] -= factor * above[i - 1];
        for (int64_t k = 0; k < n; k++)
            a[i * n + k] -= factor * a[(i - 1) * n + k];
    }
    for (int64_t k = 0; k < n; k++) {
        a[high * n + k] /= pivot[high];
        if (!first)
            a[k] = 0.0;
        if (!last)
            a[end * n + k] = 0.0;
    }
    for (int64_t i = high - 1; i >= low; i--)
        for (int64_t k = 0; k < n; k++)
            a[i * n + k] = (a[i * n + k] - above[i] * a[(i + 1) * n + k]) / pivot[i];
    for (int64_t k = 0; k < n; k++) {
        if (!first)
            q[n + k] += h0 * h0 * a[n + k] / 6.0;
        if (!last)
            q[(end - 1) * n + k] += h3 * h3 * a[(end - 1) * n + k] / 6.0;
        v[k] = first ? first[k] : 0.0;
    }
    for (int64_t i = 0; i < end; i++)
        for (int64_t k = 0; k < n; k++)
            v[(i + 1) * n + k] = v[i * n + k] + step[i] * (a[i * n + k] + a[(i + 1) * n + k]) / 2.0;
    for (int64_t k = 0; k < n; k++)
        v[end * n + k] = last ? last[k] : 0.0;
    free(work);
    return 0;
}

static double larger(double a, double b)
{
    return a > b ? a : b;
}

/* Compute the largest |velocity|, |acceleration| and |jerk| of each joint between all knots, (3, joints).

   Accelerations are linear between knots; a jump between two knots at the same time does not count as jerk. */
void largest_rates(const double *time, const double *velocity, const double *acceleration, int64_t knots,
                   int64_t joints, double *largest)
{
    const int64_t n = joints;
    for (int64_t k = 0; k < 3 * n; k++)
        largest[k] = 0.0;
    for (int64_t i = 0; i < knots; i++) {
        const double h = i + 1 < knots ? time[i + 1] - time[i] : 0.0;
        for (int64_t k = 0; k < n; k++) {
            const double v0 = velocity[i * n + k], a0 = acceleration[i * n + k];
            largest[k] = larger(largest[k], fabs(v0));
            largest[n + k] = larger(largest[n + k], fabs(a0));
            if (!(h > 0.0))
                continue;
            const double a1 = acceleration[(i + 1) * n + k], jerk = (a1 - a0) / h;
            largest[2 * n + k] = larger(largest[2 * n + k], fabs(jerk));
            /* The velocity has an extremum where the acceleration changes its sign. */
            if (a0 * a1 < 0.0)
                largest[k] = larger(largest[k], fabs(v0 - a0 * a0 / (2.0 * jerk)));
        }
    }
}
