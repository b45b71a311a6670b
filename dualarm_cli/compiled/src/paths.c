/* Derivatives of paths along their coordinates, and splines along paths. */

#include "paths.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "splines.h"

enum {
    STENCIL = 8, /* samples of an interpolating polynomial, of degree 7 */
    LANES = 8    /* joints processed together */
};

/* Floor of the slowness as a fraction of its maximum: coordinates have to rise where no joint moves, too. */
static const double MIN_SLOWNESS = 0.02;

/* Interpolate equidistant samples at a fraction of their interval by local polynomials, exactly at both ends. */
static void interpolate(const double *values, int64_t samples, int64_t width, double fraction, double *result)
{
    static const double gaps[STENCIL] = {-5040.0, 720.0, -240.0, 144.0, -144.0, 240.0, -720.0, 5040.0};
    if (fraction == 0.0 || fraction == 1.0) {
        memcpy(result, values + (fraction == 0.0 ? 0 : (samples - 1) * width), sizeof(double) * (size_t)width);
        return;
    }
    const double sample = fraction * (double)(samples - 1);
    int64_t first = (int64_t)sample - (STENCIL / 2 - 1);
    first = first < 0 ? 0 : first > samples - STENCIL ? samples - STENCIL : first;
    /* Each Lagrange polynomial is the product of all other gaps, built from both sides without dividing by a gap. */
    const double x = sample - (double)first;
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
        result[k] = 0.0;
    for (int i = 0; i < STENCIL; i++)
        for (int64_t k = 0; k < width; k++)
            result[k] += basis[i] * values[(first + i) * width + k];
}

/* Differentiate equidistant samples on [0, 1], rows of `width` numbers `stride` apart, to second order. */
static void differentiate(const double *values, int64_t samples, int64_t width, int64_t stride, double *result)
{
    const double half = 0.5 * (double)(samples - 1), step = (double)(samples - 1);
    const double *end = values + (samples - 1) * stride;
    for (int64_t i = 1; i < samples - 1; i++)
        for (int64_t k = 0; k < width; k++)
            result[i * stride + k] = half * (values[(i + 1) * stride + k] - values[(i - 1) * stride + k]);
    for (int64_t k = 0; k < width; k++) {
        result[k] = step * (-1.5 * values[k] + 2.0 * values[stride + k] - 0.5 * values[2 * stride + k]);
        result[(samples - 1) * stride + k] = step * (1.5 * end[k] - 2.0 * end[k - stride] + 0.5 * end[k - 2 * stride]);
    }
}

/* Compute the least time of a joint from rest to rest [s], as model/motion/rest_to_rest.py. */
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

/* Compute the slopes of the second and third coordinate over the first from q', q'', q''', up to a factor.

   dominant, local: both to the eighth power, (samples,). */
static void compute_slownesses(const Path *path, const double *rates, int64_t stride, double *dominant, double *local)
{
    const int64_t m = path->samples, n = path->joints;
    for (int64_t i = 0; i < m; i++)
        dominant[i] = local[i] = 0.0;
    for (int64_t k = 0; k < n; k++) {
        double travel = 0.0;
        for (int64_t i = 0; i < m; i++)
            travel += fabs(rates[3 * i * stride + k]);
        travel /= (double)m;
        const double min_time = rest_to_rest(travel, path->velocity[k], path->acceleration[k], path->jerk[k]);
        const double weight = travel > 0.0 ? min_time * min_time * min_time / travel : 0.0;
        for (int64_t i = 0; i < m; i++) {
            const double *at = rates + 3 * i * stride + k;
            /* The first slope is an 8-norm over the joints. A constant rate p has velocity q' p, acceleration q'' p^2
               and jerk q''' p^3. */
            double x = at[0] * weight, v = at[0] / path->velocity[k], a = at[stride] / path->acceleration[k];
            double j = cbrt(at[2 * stride] / path->jerk[k]);
            x *= x, v *= v, a *= a, j *= j;
            x *= x, v *= v, j *= j;
            dominant[i] += x * x;
            local[i] += v * v + a * a + j * j;
        }
    }
}

/* Invert a rising coordinate at equidistant values, given the eighth power of its slope up to a factor. */
static void invert_coordinate(double *slope, int64_t samples, double *scratch, double *fraction)
{
    double *table = scratch, max_slope = 0.0, length = 0.0;
    const double last = (double)(samples - 1);
    for (int64_t i = 0; i < samples; i++)
        max_slope = larger(max_slope, slope[i]);
    for (int64_t i = 0; i < samples; i++) {
        slope[i] = max_slope > 0.0 ? larger(sqrt(sqrt(sqrt(slope[i] / max_slope))), MIN_SLOWNESS) : 1.0;
        length += i ? (slope[i] + slope[i - 1]) / 2.0 : 0.0;
        table[2 * i] = length;
        table[2 * i + 1] = slope[i];
    }
    for (int64_t i = 0; i < samples; i++) {
        table[2 * i] /= length;
        table[2 * i + 1] *= last / length;
    }
    int64_t k = 0;
    for (int64_t i = 1; i < samples - 1; i++) {
        const double value = (double)i / last;
        while (table[2 * (k + 1)] <= value)
            k++;
        const double lower = table[2 * k], inside = (value - lower) / (table[2 * (k + 1)] - lower);
        const double estimate = ((double)k + inside) / last;
        /* One Newton step from linear interpolation has an error of about 1e-9; only smoothness matters here. */
        double at_estimate[2];
        interpolate(table, samples, 2, estimate, at_estimate);
        fraction[i] = clamp(estimate - (at_estimate[0] - value) / larger(at_estimate[1], MIN_SLOWNESS), 0.0, 1.0);
    }
    fraction[0] = 0.0;
    fraction[samples - 1] = 1.0;
}

void states_of_phases(const double *length, const double *jerk, State *state)
{
    State at = {0.0, 0.0, 0.0, 0.0};
    for (int p = 0; p < PHASES; p++) {
        at.jerk = length[p] > 0.0 ? jerk[p] : 0.0;
        state[p] = at;
        at = advance(at, length[p]);
    }
    state[PHASES] = at;
    for (int p = 0; p <= PHASES; p++)
        state[p] = (State){state[p].position / at.position, state[p].speed / at.position,
                           state[p].acceleration / at.position, state[p].jerk / at.position};
}

int measure_path(const Path *path, Measures *measures)
{
    const int64_t m = path->samples, n = path->joints, s = (n + LANES - 1) / LANES * LANES;
    double *memory = calloc((size_t)(COORDINATES * m * (2 + 3 * s) + 2 * s + m * (n + 4)), sizeof(double));
    if (!memory)
        return 1;
    *measures = (Measures){memory + COORDINATES * m * 3 * s, memory + COORDINATES * m * (3 * s + 1), memory,
                           memory + COORDINATES * m * (3 * s + 2), s};
    double *sampled = measures->scratch + 2 * s, *slope = sampled;
    for (int64_t c = 0; c < COORDINATES; c++) {
        double *rates = measures->rates + c * m * 3 * s, *fraction = measures->fraction + c * m;
        const double *position = path->position;
        if (c == 0) {
            for (int64_t i = 0; i < m; i++)
                fraction[i] = (double)i / (double)(m - 1);
        } else {
            for (int64_t i = 0; i < m; i++)
                interpolate(path->position, m, n, fraction[i], sampled + i * n);
            position = sampled;
        }
        for (int64_t i = 0; i < m; i++)
            memcpy(rates + (3 * i + 2) * s, position + i * n, sizeof(double) * (size_t)n);
        /* The positions are stored in the place of the third derivatives until those overwrite them. */
        differentiate(rates + 2 * s, m, n, 3 * s, rates);
        differentiate(rates, m, n, 3 * s, rates + s);
        differentiate(rates + s, m, n, 3 * s, rates + 2 * s);
        for (int64_t i = 0; i < m; i++) {
            double max_speed = 0.0;
            for (int64_t k = 0; k < n; k++)
                max_speed = larger(max_speed, fabs(rates[3 * i * s + k]) / path->velocity[k]);
            measures->speed[c * m + i] = max_speed;
        }
        if (c == 0) {
            double *dominant = slope, *local = slope + m, *scratch = slope + 2 * m;
            compute_slownesses(path, rates, s, dominant, local);
            invert_coordinate(dominant, m, scratch, measures->fraction + m);
            invert_coordinate(local, m, scratch, measures->fraction + 2 * m);
        }
    }
    return 0;
}

void free_measures(Measures *measures)
{
    free(measures->rates);
}

Peaks start_peaks(const Path *path, const Measures *measures, int64_t coordinate)
{
    const int64_t m = path->samples, s = measures->stride;
    memset(measures->scratch, 0, sizeof(double) * (size_t)(2 * s));
    return (Peaks){path, measures, measures->speed + coordinate * m, measures->rates + coordinate * m * 3 * s, 0.0};
}

void add_state(Peaks *peaks, State state)
{
    const int64_t s = peaks->measures->stride;
    const int64_t sample = (int64_t)(state.position * (double)(peaks->path->samples - 1) + 0.5);
    const double v2 = state.speed * state.speed, va = 3.0 * state.speed * state.acceleration, v3 = v2 * state.speed;
    const double *restrict first = peaks->rates + 3 * sample * s;
    double *restrict peak = peaks->measures->scratch;
    peaks->velocity = larger(peaks->velocity, peaks->speed[sample] * state.speed);
    for (int64_t b = 0; b < s; b += LANES)
        for (int64_t k = b; k < b + LANES; k++) {
            const double a = fabs(first[k] * state.acceleration + first[s + k] * v2);
            const double j = fabs(first[k] * state.jerk + first[s + k] * va + first[2 * s + k] * v3);
            peak[k] = larger(a, peak[k]);
            peak[s + k] = larger(j, peak[s + k]);
        }
}

double min_duration(const Peaks *peaks)
{
    const Path *path = peaks->path;
    const double *peak_a = peaks->measures->scratch, *peak_j = peak_a + peaks->measures->stride;
    double a = 0.0, j = 0.0;
    for (int64_t k = 0; k < path->joints; k++) {
        a = larger(a, peak_a[k] / path->acceleration[k]);
        j = larger(j, peak_j[k] / path->jerk[k]);
    }
    return larger(peaks->velocity, larger(sqrt(a), cbrt(j)));
}

int spline_along_path(const Path *path, const double *fraction, const double *distance, int64_t knots,
                      const double *end_velocity, Motion motion)
{
    const int64_t n = path->joints;
    double *largest = malloc(sizeof(double) * (size_t)(3 * n)), factor = 0.0;
    if (!largest)
        return 1;
    for (int64_t i = 0; i < knots; i++) {
        double path_fraction;
        interpolate(fraction, path->samples, 1, distance[i], &path_fraction);
        interpolate(path->position, path->samples, n, clamp(path_fraction, 0.0, 1.0), motion.position + i * n);
    }
    const int failed =
        cubic_spline(motion.time, knots, n, NULL, end_velocity, motion.position, motion.velocity, motion.acceleration);
    if (!failed) {
        largest_rates(motion.time, motion.velocity, motion.acceleration, knots, n, largest);
        for (int64_t k = 0; k < n; k++) {
            const double a = sqrt(largest[n + k] / path->acceleration[k]), j = cbrt(largest[2 * n + k] / path->jerk[k]);
            factor = larger(factor, larger(largest[k] / path->velocity[k], larger(a, j)));
        }
        factor *= ROUNDING;
        for (int64_t i = 0; i < knots; i++)
            motion.time[i] *= factor;
        for (int64_t i = 0; i < knots * n; i++) {
            motion.velocity[i] /= factor;
            motion.acceleration[i] /= factor * factor;
        }
    }
    free(largest);
    return failed;
}
