/* Enclosures of the joint positions over cells of platform angle and arm angle. Purpose: `bound/cells.py`.

   A range has a middle and a radius. Functions of the platform angle are ranges of their value and two derivatives
   (`Jet`), with products, quotients and roots by automatic differentiation. */

#include <math.h>
#include <string.h>

#include "postures.h"

/* Largest uncertainty from the derivatives at which a joint's range of values is not computed [rad]. */
static const double MAX_SLACK = 0.03;

/* Distance between shoulder and wrist below which the direction between them is undefined [m]. */
static const double MIN_DISTANCE = 1e-5;

static double length(double x, double y)
{
    return sqrt(x * x + y * y);
}

/* Compute the largest magnitude in a range. */
static double magnitude(Range a)
{
    return fabs(a.middle) + a.radius;
}

static Range sum(Range a, Range b)
{
    return (Range){a.middle + b.middle, a.radius + b.radius};
}

static Range scaled(double factor, Range a)
{
    return (Range){factor * a.middle, fabs(factor) * a.radius};
}

static Range product(Range a, Range b)
{
    return (Range){a.middle * b.middle, fabs(a.middle) * b.radius + a.radius * magnitude(b)};
}

static Range between(double low, double high)
{
    return (Range){0.5 * (low + high), 0.5 * (high - low)};
}

static Range square(Range a)
{
    const double low = fmax(fabs(a.middle) - a.radius, 0.0), high = magnitude(a);
    return between(low * low, high * high);
}

static Range inverse(Range a)
{
    const double low = a.middle - a.radius, high = a.middle + a.radius;
    return low > 0.0 || high < 0.0 ? between(1.0 / high, 1.0 / low) : (Range){0.0, INFINITY};
}

static Range root(Range a)
{
    if (!isfinite(a.middle) || !isfinite(a.radius))
        return (Range){0.0, INFINITY};
    return between(sqrt(fmax(a.middle - a.radius, 0.0)), sqrt(fmax(a.middle + a.radius, 0.0)));
}

static Jet jet_sum(Jet a, Jet b)
{
    Jet c;
    for (int i = 0; i < 3; i++)
        c.of[i] = sum(a.of[i], b.of[i]);
    return c;
}

static Jet jet_scaled(double factor, Jet a)
{
    Jet c;
    for (int i = 0; i < 3; i++)
        c.of[i] = scaled(factor, a.of[i]);
    return c;
}

static Jet jet_product(Jet a, Jet b)
{
    const Range mixed = scaled(2.0, product(a.of[1], b.of[1]));
    return (Jet){{product(a.of[0], b.of[0]), sum(product(a.of[1], b.of[0]), product(a.of[0], b.of[1])),
                  sum(sum(product(a.of[2], b.of[0]), product(a.of[0], b.of[2])), mixed)}};
}

static Jet jet_inverse(Jet a)
{
    const Range reciprocal = inverse(a.of[0]), squared = product(reciprocal, reciprocal);
    const Range second = scaled(2.0, product(square(a.of[1]), product(squared, reciprocal)));
    return (Jet){{reciprocal, scaled(-1.0, product(a.of[1], squared)),
                  sum(second, scaled(-1.0, product(a.of[2], squared)))}};
}

static Jet jet_root(Jet a)
{
    const Range value = root(a.of[0]), half = scaled(0.5, inverse(value));
    const Range second = product(square(a.of[1]), product(half, square(half)));
    return (Jet){{value, product(a.of[1], half), sum(product(a.of[2], half), scaled(-2.0, second))}};
}

/* Compute the jet of constant + p cos(phi) + q sin(phi) over the interval of the platform angle phi. */
static Jet sinusoid(const Shape *shape, double constant, double p, double q)
{
    const double middle = 0.5 * (shape->low + shape->high), h = 0.5 * (shape->high - shape->low);
    const double c = cos(middle), s = sin(middle), value = p * c + q * s, slope = q * c - p * s;
    const double second = 0.5 * hypot(p, q) * h * h;
    return (Jet){{{constant + value, fabs(slope) * h + second},
                  {slope, fabs(value) * h + second},
                  {-value, fabs(slope) * h + second}}};
}

/* Compute a constant plus the dot product of a vector fixed in the world and one that turns with the platform. */
static Jet seen_component(const Shape *shape, const double *in_world, const double *on_platform, double constant)
{
    return sinusoid(shape, in_world[2] * on_platform[2] + constant,
                    in_world[0] * on_platform[0] + in_world[1] * on_platform[1],
                    in_world[1] * on_platform[0] - in_world[0] * on_platform[1]);
}

static Jet fixed(double value)
{
    return (Jet){{{value, 0.0}, {0.0, 0.0}, {0.0, 0.0}}};
}

/* Rotate a vector about the z axis. */
static void rotate_z(double angle, const double *v, int64_t stride, double *out)
{
    const double c = cos(angle), s = sin(angle);
    out[0] = c * v[0] - s * v[stride];
    out[stride] = s * v[0] + c * v[stride];
    out[2 * stride] = v[2 * stride];
}

/* Compute the curves of a pose seen from a platform angle, and u, r and t of the arm plane in the carried frame. */
static void view_from(const Arm *arm, const double *R, const double *p, double angle, Curves *curves,
                      double directions[3][3])
{
    double seen_R[9], seen_p[3];
    for (int k = 0; k < 3; k++)
        rotate_z(-angle, R + k, 3, seen_R + k);
    rotate_z(-angle, p, 1, seen_p);
    compute_curves(arm, seen_R, seen_p, curves);
    const double *plane[3] = {curves->u, curves->r, curves->t};
    for (int v = 0; v < 3; v++)
        for (int i = 0; i < 3; i++)
            directions[v][i] = dot(arm->B + 3 * i, plane[v]);
}

/* Compute cosine and sine of the angle between a link and the line from shoulder to wrist (law of cosines). */
static void link_angle(double link, double other_link, Jet distance, Jet reciprocal, Jet *cosine, Jet *sine)
{
    *cosine = jet_sum(jet_scaled(0.5 / link, distance),
                      jet_scaled(0.5 * (link * link - other_link * other_link) / link, reciprocal));
    Jet squared = jet_scaled(-1.0, jet_product(*cosine, *cosine));
    squared.of[0] = sum((Range){1.0, 0.0}, scaled(-1.0, square(cosine->of[0])));
    *sine = jet_root(squared);
}

/* Compute the components of the transported arm plane along a vector, from those of the middle's plane and the line. */
static void plane_components(const Jet middle[3], Jet line, const Jet tilt[2], Jet components[3])
{
    const Jet total = jet_sum(middle[0], line);
    components[0] = line;
    for (int i = 0; i < 2; i++)
        components[1 + i] = jet_sum(middle[1 + i], jet_scaled(-1.0, jet_product(tilt[i], total)));
}

static Wave wave_of(Jet sine, Jet cosine, Jet constant)
{
    Wave wave = {sine, cosine, constant, {0.0, 0.0, 0.0}};
    for (int d = 0; d < 3; d++)
        wave.size[d] = length(sine.of[d].middle, cosine.of[d].middle);
    return wave;
}

void compute_shape(const Arm *arm, const double *R, const double *p, double low, double high, Shape *shape)
{
    const double a = arm->upper_arm, b = arm->fore_arm, *S = arm->shoulder;
    double W[3], world[3][3], axis[3][3], tool[3][3];
    Curves curves;
    shape->low = low;
    shape->high = high;
    view_from(arm, R, p, 0.5 * (low + high), &curves, shape->frame);
    for (int i = 0; i < 3; i++) {
        W[i] = p[i] + dot(R + 3 * i, arm->flange_wrist);
        rotate_z(0.5 * (low + high), shape->frame[i], 1, world[i]);
        for (int j = 0; j < 3; j++) {
            axis[i][j] = arm->B[3 * j + i];
            tool[i][j] = dot(R + 3 * j, arm->C + 3 * i);
        }
    }
    /* Distance from shoulder to wrist; the shoulder turns with the platform. */
    const double twice[3] = {-2.0 * W[0], -2.0 * W[1], -2.0 * W[2]};
    const Jet distance = jet_root(seen_component(shape, twice, S, dot(W, W) + dot(S, S)));
    const Range range = distance.of[0], unbounded = {0.0, INFINITY};
    const int is_defined = range.middle - range.radius > MIN_DISTANCE;
    const Jet reciprocal = is_defined ? jet_inverse(distance) : (Jet){{unbounded, unbounded, unbounded}};
    Jet along[3], tilt[2], ca, sa, cf, sf;
    for (int i = 0; i < 3; i++) {
        const double negative[3] = {-world[i][0], -world[i][1], -world[i][2]};
        along[i] = jet_product(seen_component(shape, negative, S, dot(W, world[i])), reciprocal);
    }
    const Jet reciprocal_sum = jet_inverse(jet_sum(fixed(1.0), along[0]));
    for (int i = 0; i < 2; i++)
        tilt[i] = jet_product(along[1 + i], reciprocal_sum);
    link_angle(a, b, distance, reciprocal, &ca, &sa);
    link_angle(b, a, distance, reciprocal, &cf, &sf);
    shape->bend = jet_scaled(0.5 / (a * b), jet_product(distance, distance));
    shape->bend.of[0] = sum(scaled(0.5 / (a * b), square(distance.of[0])),
                            (Range){-0.5 * (a * a + b * b) / (a * b), 0.0});
    Jet upper_arm[3][3], forearm[3][3]; /* components of u, r and t along base axes and along tool axes */
    for (int i = 0; i < 3; i++) {
        Jet middle[3], fixed_middle[3];
        for (int v = 0; v < 3; v++) {
            middle[v] = seen_component(shape, world[v], axis[i], 0.0);
            fixed_middle[v] = fixed(dot(world[v], tool[i]));
        }
        const double negative[3] = {-tool[i][0], -tool[i][1], -tool[i][2]};
        plane_components(middle, jet_product(seen_component(shape, W, axis[i], -dot(S, axis[i])), reciprocal), tilt,
                         upper_arm[i]);
        plane_components(fixed_middle, jet_product(seen_component(shape, negative, S, dot(W, tool[i])), reciprocal),
                         tilt, forearm[i]);
    }
    const Range link[2][2] = {{ca.of[0], sa.of[0]}, {cf.of[0], sf.of[0]}};
    memcpy(shape->link, link, sizeof link);
    Wave *wave = shape->wave;
    const Jet zero = fixed(0.0), negative_sf = jet_scaled(-1.0, sf);
    for (int i = 0; i < 3; i++) {
        /* The upper arm along the axes: z, y, x; the forearm along those of the tool: z, y, -x. */
        const Jet *u = upper_arm[2 - i], *f = forearm[2 - i];
        wave[i] = wave_of(jet_product(sa, u[2]), jet_product(sa, u[1]), jet_product(ca, u[0]));
        const Jet bent_sine = i == 2 ? sf : negative_sf, straight_cosine = i == 2 ? jet_scaled(-1.0, cf) : cf;
        wave[i ? 7 + i : 5] = wave_of(jet_product(bent_sine, f[2]), jet_product(bent_sine, f[1]),
                                      jet_product(straight_cosine, f[0]));
    }
    const Jet *z = upper_arm[2], *f = forearm[2];
    wave[3] = wave_of(z[1], jet_scaled(-1.0, z[2]), zero);
    wave[4] = wave_of(jet_product(ca, z[2]), jet_product(ca, z[1]), jet_scaled(-1.0, jet_product(sa, z[0])));
    wave[6] = wave_of(f[1], jet_scaled(-1.0, f[2]), zero);
    wave[7] = wave_of(jet_scaled(-1.0, jet_product(cf, f[2])), jet_scaled(-1.0, jet_product(cf, f[1])),
                      jet_product(negative_sf, f[0]));
}

/* Compute the arm angle of the middle's reference direction after the smallest rotation in the world. */
static double transported_angle(const double middle[3][3], double directions[3][3], double turn)
{
    double u[3], r[3], t[3], transported[3];
    rotate_z(turn, directions[0], 1, u);
    rotate_z(turn, directions[1], 1, r);
    rotate_z(turn, directions[2], 1, t);
    const double factor = dot(middle[1], u) / fmax(1.0 + dot(middle[0], u), 1e-12);
    for (int i = 0; i < 3; i++)
        transported[i] = middle[1][i] - factor * (middle[0][i] + u[i]);
    return atan2(dot(transported, t), dot(transported, r));
}

void compute_corners(const Arm *arm, const double *R, const double *p, const Shape *shape, int64_t parts,
                     double *corner)
{
    for (int side = 0; side < 2; side++) {
        const double angle = side ? shape->high : shape->low;
        double directions[3][3];
        Curves curves;
        view_from(arm, R, p, angle, &curves, directions);
        const double shift = transported_angle(shape->frame, directions, angle - 0.5 * (shape->low + shape->high));
        for (int64_t k = 0; k < parts; k++) {
            const double psi = -PI + TURN * (double)k / (double)parts + shift;
            double q[4], theta[2], *cell = corner + (side * parts + k) * JOINTS;
            angles_at(arm, &curves, sin(psi), cos(psi), q, theta);
            for (int j = 0; j < 4; j++)
                cell[2 * j] = q[j];
            /* At a singular triple, whose first joint is arbitrary, the middle one may be an ulp below zero. */
            cell[1] = fabs(theta[0]);
            cell[3] = curves.bend;
            cell[5] = fabs(theta[1]);
        }
    }
}

/* Ranges of a wave over a part of the circle: value, derivatives by platform angle (1, 2) and by arm angle (3, 4). */
typedef struct {
    Range of[5];
} Sample;

/* Compute the range of a wave over half-width h of the arm angle; `size` is its amplitude. */
static Range wave_range(Range sine, Range cosine, Range constant, double size, double s, double c, double h)
{
    const double slope = sine.middle * c - cosine.middle * s;
    return (Range){sine.middle * s + cosine.middle * c + constant.middle,
                   sine.radius + cosine.radius + constant.radius +
                       fmin(fabs(slope) * h + 0.5 * size * h * h, 2.0 * size)};
}

/* Compute the ranges of a wave over a part of the circle. */
static Sample sample_wave(const Wave *wave, double s, double c, double h)
{
    Sample sample;
    const Jet *a = &wave->sine, *b = &wave->cosine;
    const Range zero = {0.0, 0.0};
    for (int i = 0; i < 3; i++)
        sample.of[i] = wave_range(a->of[i], b->of[i], wave->constant.of[i], wave->size[i], s, c, h);
    sample.of[3] = wave_range(scaled(-1.0, b->of[0]), a->of[0], zero, wave->size[0], s, c, h);
    sample.of[4] = wave_range(scaled(-1.0, a->of[0]), scaled(-1.0, b->of[0]), zero, wave->size[0], s, c, h);
    return sample;
}

/* Set the second derivatives of a joint; return whether they bound its values tightly. h: half-widths of the cell. */
static int set_derivatives(Bends *bends, int joint, double sign, const Range first[DIRECTIONS],
                           const Range second[DIRECTIONS], const double h[DIRECTIONS])
{
    double slack = 0.0;
    bends->smooth[joint] = 1;
    for (int d = 0; d < DIRECTIONS; d++) {
        bends->second[d][joint] = scaled(sign, second[d]);
        slack += 0.5 * magnitude(second[d]) * h[d] * h[d];
        bends->smooth[joint] &= magnitude(first[d]) * h[d] < 0.5 * PI && magnitude(second[d]) < INFINITY;
    }
    bends->value[joint] = (Range){0.0, INFINITY};
    return slack < MAX_SLACK;
}

/* Triple of joints over a part of the circle. */
typedef struct {
    const Sample *cosine;              /* of the middle joint */
    const Sample *along;               /* denominator of the inner tangent */
    const Sample *outer[2], *inner[2]; /* numerators and denominators of the tangents */
    Range sine, weight, link[2];       /* sine of the middle joint, 1 / sine^2, cosine and sine of the link's angle */
} Triple;

/* Set the arc tangent of a quotient of waves; its derivatives by the arm angle are given. */
static void set_tangent(Bends *bends, const Arm *arm, int joint, const Triple *triple, const Sample *const wave[2],
                        Range first_psi, Range second_psi, const double h[DIRECTIONS])
{
    const double sign = arm->sign[joint];
    const Range n = wave[0]->of[0], d = wave[1]->of[0];
    const Range cross = sum(product(d, wave[0]->of[1]), scaled(-1.0, product(n, wave[1]->of[1])));
    const Range second_cross = sum(product(d, wave[0]->of[2]), scaled(-1.0, product(n, wave[1]->of[2])));
    const Range cosine_change = product(triple->weight, product(triple->cosine->of[0], triple->cosine->of[1]));
    const Range first = product(triple->weight, cross);
    const Range second = sum(product(triple->weight, second_cross), scaled(2.0, product(cosine_change, first)));
    if (set_derivatives(bends, joint, sign, (Range[]){first, first_psi}, (Range[]){second, second_psi}, h))
        return;
    const double size = length(n.middle, d.middle), uncertainty = length(n.radius, d.radius);
    bends->value[joint] = (Range){sign * (atan2(n.middle, d.middle) - arm->offset[joint]),
                                  uncertainty < size ? asin(uncertainty / size) : INFINITY};
}

/* Set the arc cosine of a wave, given the range of its sine. */
static void set_cosine(Bends *bends, int joint, const Sample *cosine, Range sine, const double h[DIRECTIONS])
{
    const Range c = cosine->of[0], weight = inverse(sine);
    Range first[DIRECTIONS], second[DIRECTIONS];
    for (int k = 0; k < DIRECTIONS; k++) {
        first[k] = scaled(-1.0, product(weight, cosine->of[1 + 2 * k]));
        second[k] = scaled(-1.0, product(weight, sum(cosine->of[2 + 2 * k], product(c, square(first[k])))));
    }
    if (set_derivatives(bends, joint, 1.0, first, second, h))
        return;
    const double reach = c.radius < 2.0 ? c.radius : 2.0;
    bends->value[joint] = between(acos(fmin(fmax(c.middle + reach, -1.0), 1.0)),
                                  acos(fmin(fmax(c.middle - reach, -1.0), 1.0)));
}

/* Set the joints of a triple.

   The arm angle turns both links about the line from shoulder to wrist. With c the middle joint's cosine, e the wave
   `along`, and s, k sine and cosine of the angle between link and line, the derivatives by the arm angle are
   -s e / (1 - c²) for the outer joint and k + s c e / (1 - c²) for the inner one; those of the wrist are negated. */
static void set_triple(Bends *bends, const Arm *arm, int wrist, Triple *triple, const double h[DIRECTIONS])
{
    const double sign = wrist ? -1.0 : 1.0;
    const Range c = triple->cosine->of[0], c_1 = triple->cosine->of[3];
    const Range e = triple->along->of[0], e_1 = triple->along->of[3];
    triple->weight = inverse(square(triple->sine));
    const Range se = scaled(sign, product(triple->link[1], triple->weight));
    const Range cotangent_squared = product(product(c, c), triple->weight), turn = product(e, c_1);
    const Range correction = product(turn, sum((Range){1.0, 0.0}, scaled(2.0, cotangent_squared)));
    const Range outer = sum(product(se, e_1), scaled(2.0, product(product(se, triple->weight), product(c, turn))));
    const Range inner = product(se, sum(product(e_1, c), correction));
    set_tangent(bends, arm, JOINT[wrist][0], triple, triple->outer, scaled(-1.0, product(se, e)), scaled(-1.0, outer),
                h);
    set_cosine(bends, JOINT[wrist][1], triple->cosine, triple->sine, h);
    set_tangent(bends, arm, JOINT[wrist][2], triple, triple->inner,
                sum(scaled(sign, triple->link[0]), product(se, product(c, e))), inner, h);
}

static Range narrower(Range a, Range b)
{
    return a.radius < b.radius ? a : b;
}

/* Compute the range of the length of a vector of two waves. */
static Range sample_length(const Sample *a, const Sample *b)
{
    return (Range){length(a->of[0].middle, b->of[0].middle), length(a->of[0].radius, b->of[0].radius)};
}

void compute_bends(const Arm *arm, const Shape *shape, int64_t parts, Bends *bends)
{
    const double h[DIRECTIONS] = {0.5 * (shape->high - shape->low), PI / (double)parts};
    const Sample bend = {{shape->bend.of[0], shape->bend.of[1], shape->bend.of[2], {0.0, 0.0}, {0.0, 0.0}}};
    const Range bend_sine = root(sum((Range){1.0, 0.0}, scaled(-1.0, square(bend.of[0]))));
    for (int64_t k = 0; k < parts; k++) {
        const double psi = -PI + TURN * ((double)k + 0.5) / (double)parts, s = sin(psi), c = cos(psi);
        Sample sample[WAVES];
        for (int i = 0; i < WAVES; i++)
            sample[i] = sample_wave(shape->wave + i, s, c, h[1]);
        for (int wrist = 0; wrist < 2; wrist++) {
            const Sample *cosine = sample + 5 * wrist, *inner = cosine + (wrist ? 1 : 3);
            const Sample *outer = cosine + (wrist ? 3 : 1);
            Triple triple = {cosine, inner + 1, {outer, outer + 1}, {inner, inner + 1}, .link = {{0.0, 0.0}}};
            /* The sine of the middle joint is the narrowest of three enclosures. */
            const Range sine_from_cosine = root(sum((Range){1.0, 0.0}, scaled(-1.0, square(cosine->of[0]))));
            triple.sine = narrower(narrower(sample_length(inner, inner + 1), sample_length(outer, outer + 1)),
                                   sine_from_cosine);
            triple.link[0] = shape->link[wrist][0];
            triple.link[1] = shape->link[wrist][1];
            set_triple(bends + k, arm, wrist, &triple, h);
        }
        set_cosine(bends + k, 3, &bend, bend_sine, h);
    }
}

void compute_spans(int64_t parts, const double h[DIRECTIONS], const double *corner, const Bends *bends, Span *span)
{
    for (int64_t k = 0; k < parts; k++) {
        const int64_t next = (k + 1) % parts;
        const double *at[CORNERS] = {corner + k * JOINTS, corner + next * JOINTS, corner + (parts + next) * JOINTS,
                                     corner + (parts + k) * JOINTS};
        for (int joint = 0; joint < JOINTS; joint++) {
            const Range value = bends[k].value[joint];
            Span *joint_span = span + k * JOINTS + joint;
            *joint_span = (Span){value.middle - value.radius - ROUNDING, value.middle + value.radius + ROUNDING};
            if (!bends[k].smooth[joint])
                continue;
            double change = 0.0, min_change = 0.0, max_change = 0.0, below = ROUNDING, above = ROUNDING;
            for (int c = 1; c < CORNERS; c++) {
                const double step = at[c][joint] - at[c - 1][joint];
                change += step - TURN * nearbyint(step / TURN);
                min_change = fmin(min_change, change);
                max_change = fmax(max_change, change);
            }
            for (int d = 0; d < DIRECTIONS; d++)
                add_slack(bends[k].second[d][joint], h[d], &below, &above);
            if (max_change - min_change + below + above < joint_span->high - joint_span->low)
                *joint_span = (Span){at[0][joint] + min_change - below, at[0][joint] + max_change + above};
        }
    }
}
