/* Measures of paths along their coordinates, and splines along paths. */

#include "paths.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "splines.h"

enum {
    STENCIL = 8, /* neighbouring samples in interpolation: polynomials of seventh degree */
    LANES = 8    /* joints are looked at by so many at a time */
};

/* Floor of the slowness, as a share of its largest: where no joint moves a coordinate still rises. */
static const double LEAST_SLOWNESS = 0.02;

/* A sampled path at a share of its length, by local polynomials; both ends come back exactly. */
static void interpolated(const double *values, int64_t samples, int64_t width, double share, double *found)
{
    static const double gaps[STENCIL] = {-5040.0, 720.0, -240.0, 144.0, -144.0, 240.0, -720.0, 5040.0};
    if (share == 0.0 || share == 1.0) {
        memcpy(found, values + (share == 0.0 ? 0 : (samples - 1) * width), sizeof(double) * (size_t)width);
        return;
    }
    const double place = share * (double)(samples - 1);
    int64_t first = (int64_t)place - (STENCIL / 2 - 1);
    first = first < 0 ? 0 : first > samples - STENCIL ? samples - STENCIL : first;
    /* Each node's polynomial is the product of all other gaps, from both sides: nothing is divided by a gap. */
    const double x = place - (double)first;
    double basis[STENCIL], product = 1.0;
    for (int i = 0; i < STENCIL; i++) {
        basis[i] = product;
        product *= x - (double)i;
    }
    product = 1.0;
    for (int i = STENCIL - 1; i >= 0; i--) {
        basis[i] = basis[i] * product / gaps[i];
        product *= x - (double)i;
    }
    for (int64_t k = 0; k < width; k++)
        found[k] = 0.0;
    for (int i = 0; i < STENCIL; i++)
        for (int64_t k = 0; k < width; k++)
            found[k] += basis[i] * values[(first + i) * width + k];
}

/* Derivative of equidistant samples on [0, 1], rows of `width` numbers, `stride` apart: second order everywhere. */
static void derivative(const double *values, int64_t samples, int64_t width, int64_t stride, double *found)
{
    const double half = 0.5 * (double)(samples - 1), step = (double)(samples - 1);
    const double *end = values + (samples - 1) * stride;
    for (int64_t i = 1; i < samples - 1; i++)
        for (int64_t k = 0; k < width; k++)
            found[i * stride + k] = half * (values[(i + 1) * stride + k] - values[(i - 1) * stride + k]);
    for (int64_t k = 0; k < width; k++) {
        found[k] = step * (-1.5 * values[k] + 2.0 * values[stride + k] - 0.5 * values[2 * stride + k]);
        found[(samples - 1) * stride + k] = step * (1.5 * end[k] - 2.0 * end[k - stride] + 0.5 * end[k - 2 * stride]);
    }
}

/* Least time of one joint from rest to rest, see model/rest_to_rest.py. */
static double rest_to_rest(double distance, double velocity, double acceleration, double jerk)
{
    const double ramp = acceleration / jerk, half = 0.5 * acceleration * ramp;
    const int reaches = velocity * jerk >= acceleration * acceleration;
    const double rise = reaches ? velocity / acceleration + ramp : 2.0 * sqrt(velocity / jerk);
    if (distance >= velocity * rise)
        return distance / velocity + rise;
    if (!reaches || distance <= 2.0 * acceleration * ramp * ramp)
        return cbrt(distance * 32.0 / jerk);
    return (sqrt(distance * acceleration + half * half) - half) * 2.0 / acceleration + 2.0 * ramp;
}

/* Slopes of the second and third coordinate over the first, up to a factor, (samples,) each, from q', q'', q'''. */
static void slownesses(const Path *path, const double *rates, int64_t stride, double *deciding, double *steady)
{
    const int64_t m = path->samples, n = path->joints;
    for (int64_t i = 0; i < m; i++)
        deciding[i] = steady[i] = 0.0;
    for (int64_t k = 0; k < n; k++) {
        double way = 0.0;
        for (int64_t i = 0; i < m; i++)
            way += fabs(rates[3 * i * stride + k]);
        way /= (double)m;
        const double least = rest_to_rest(way, path->velocity[k], path->acceleration[k], path->jerk[k]);
        const double weight = way > 0.0 ? least * least * least / way : 0.0;
        for (int64_t i = 0; i < m; i++) {
            const double *at = rates + 3 * i * stride + k;
            /* The eighth power of the first is summed; velocity, acceleration and jerk of a steady pace p are
               q' p, q'' p^2, q''' p^3. */
            double one = at[0] * weight, v = at[0] / path->velocity[k], a = at[stride] / path->acceleration[k];
            double j = cbrt(at[2 * stride] / path->jerk[k]);
            one *= one, v *= v, a *= a, j *= j;
            one *= one, v *= v, j *= j;
            deciding[i] += one * one;
            steady[i] += v * v + a * a + j * j;
        }
    }
}

/* Where a rising coordinate, given by its slope up to a factor to the eighth power, takes equidistant values. */
static void inverse(double *slope, int64_t samples, double *room, double *share)
{
    double *both = room, most = 0.0, length = 0.0;
    const double last = (double)(samples - 1);
    for (int64_t i = 0; i < samples; i++)
        most = larger(most, slope[i]);
    for (int64_t i = 0; i < samples; i++) {
        slope[i] = most > 0.0 ? larger(sqrt(sqrt(sqrt(slope[i] / most))), LEAST_SLOWNESS) : 1.0;
        length += i ? (slope[i] + slope[i - 1]) / 2.0 : 0.0;
        both[2 * i] = length;
        both[2 * i + 1] = slope[i];
    }
    for (int64_t i = 0; i < samples; i++) {
        both[2 * i] /= length;
        both[2 * i + 1] *= last / length;
    }
    int64_t k = 0;
    for (int64_t i = 1; i < samples - 1; i++) {
        const double wanted = (double)i / last;
        while (both[2 * (k + 1)] <= wanted)
            k++;
        const double below = both[2 * k], part = (wanted - below) / (both[2 * (k + 1)] - below);
        const double near = ((double)k + part) / last;
        /* One Newton step from linear interpolation leaves about 1e-9; only smoothness matters here. */
        double found[2];
        interpolated(both, samples, 2, near, found);
        share[i] = within(near - (found[0] - wanted) / larger(found[1], LEAST_SLOWNESS), 0.0, 1.0);
    }
    share[0] = 0.0;
    share[samples - 1] = 1.0;
}

int measure(const Path *path, Measures *own)
{
    const int64_t m = path->samples, n = path->joints, s = (n + LANES - 1) / LANES * LANES;
    double *all = calloc((size_t)(COORDINATES * m * (2 + 3 * s) + 2 * s + m * (n + 4)), sizeof(double));
    if (!all)
        return 1;
    *own = (Measures){all + COORDINATES * m * 3 * s, all + COORDINATES * m * (3 * s + 1), all,
                      all + COORDINATES * m * (3 * s + 2), s};
    double *sampled = own->room + 2 * s, *slope = sampled;
    for (int64_t c = 0; c < COORDINATES; c++) {
        double *rates = own->rates + c * m * 3 * s, *share = own->share + c * m;
        const double *position = path->position;
        if (c == 0) {
            for (int64_t i = 0; i < m; i++)
                share[i] = (double)i / (double)(m - 1);
        } else {
            for (int64_t i = 0; i < m; i++)
                interpolated(path->position, m, n, share[i], sampled + i * n);
            position = sampled;
        }
        for (int64_t i = 0; i < m; i++)
            memcpy(rates + (3 * i + 2) * s, position + i * n, sizeof(double) * (size_t)n);
        /* The positions lie where the third derivatives will. */
        derivative(rates + 2 * s, m, n, 3 * s, rates);
        derivative(rates, m, n, 3 * s, rates + s);
        derivative(rates + s, m, n, 3 * s, rates + 2 * s);
        for (int64_t i = 0; i < m; i++) {
            double most = 0.0;
            for (int64_t k = 0; k < n; k++)
                most = larger(most, fabs(rates[3 * i * s + k]) / path->velocity[k]);
            own->speed[c * m + i] = most;
        }
        if (c == 0) {
            double *deciding = slope, *steady = slope + m, *rest = slope + 2 * m;
            slownesses(path, rates, s, deciding, steady);
            inverse(deciding, m, rest, own->share + m);
            inverse(steady, m, rest, own->share + 2 * m);
        }
    }
    return 0;
}

void release(Measures *own)
{
    free(own->rates);
}

Needs needs_of(const Path *path, const Measures *measures, int64_t coordinate)
{
    const int64_t m = path->samples, s = measures->stride;
    memset(measures->room, 0, sizeof(double) * (size_t)(2 * s));
    return (Needs){path, measures, measures->speed + coordinate * m, measures->rates + coordinate * m * 3 * s, 0.0};
}

void look(Needs *needs, State at)
{
    const int64_t s = needs->measures->stride, place = (int64_t)(at.way * (double)(needs->path->samples - 1) + 0.5);
    const double v2 = at.speed * at.speed, va = 3.0 * at.speed * at.acceleration, v3 = v2 * at.speed;
    const double *restrict first = needs->rates + 3 * place * s;
    double *restrict largest = needs->measures->room;
    needs->velocity = larger(needs->velocity, needs->speed[place] * at.speed);
    for (int64_t b = 0; b < s; b += LANES)
        for (int64_t k = b; k < b + LANES; k++) {
            const double a = fabs(first[k] * at.acceleration + first[s + k] * v2);
            const double j = fabs(first[k] * at.jerk + first[s + k] * va + first[2 * s + k] * v3);
            largest[k] = larger(a, largest[k]);
            largest[s + k] = larger(j, largest[s + k]);
        }
}

double needed_time(const Needs *needs)
{
    const Path *path = needs->path;
    const double *largest_a = needs->measures->room, *largest_j = largest_a + needs->measures->stride;
    double a = 0.0, j = 0.0;
    for (int64_t k = 0; k < path->joints; k++) {
        a = larger(a, largest_a[k] / path->acceleration[k]);
        j = larger(j, largest_j[k] / path->jerk[k]);
    }
    return larger(needs->velocity, larger(sqrt(a), cbrt(j)));
}

int along(const Path *path, const double *share, const double *way, int64_t knots, const double *last, Motion found)
{
    const int64_t n = path->joints;
    double *largest = malloc(sizeof(double) * (size_t)(3 * n)), factor = 0.0;
    if (!largest)
        return 1;
    for (int64_t i = 0; i < knots; i++) {
        double place;
        interpolated(share, path->samples, 1, way[i], &place);
        interpolated(path->position, path->samples, n, within(place, 0.0, 1.0), found.position + i * n);
    }
    const int failed =
        cubic_spline(found.time, knots, n, NULL, last, found.position, found.velocity, found.acceleration);
    if (!failed) {
        largest_rates(found.time, found.velocity, found.acceleration, knots, n, largest);
        for (int64_t k = 0; k < n; k++) {
            const double a = sqrt(largest[n + k] / path->acceleration[k]), j = cbrt(largest[2 * n + k] / path->jerk[k]);
            factor = larger(factor, larger(largest[k] / path->velocity[k], larger(a, j)));
        }
        factor *= ROUNDING;
        for (int64_t i = 0; i < knots; i++)
            found.time[i] *= factor;
        for (int64_t i = 0; i < knots * n; i++) {
            found.velocity[i] /= factor;
            found.acceleration[i] /= factor * factor;
        }
    }
    free(largest);
    return failed;
}
