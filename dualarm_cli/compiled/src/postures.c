/* Enclosures of what joints do over cells of platform angle and arm angle: `bound/cells.py` explains what for.

   Ranges are a middle and a radius. Of functions of the platform angle ranges of the value and of two derivatives are
   carried along (`Jet`), so that products, quotients and roots have theirs. */

#include <math.h>
#include <string.h>

#include "postures.h"

/* A joint's values count beside its corners where derivatives leave more than this open [rad]. */
static const double WELL = 0.03;

/* Where the wrist may be this close to the shoulder, nothing is known of the directions between them [m]. */
static const double TINY = 1e-5;

static double length(double x, double y)
{
    return sqrt(x * x + y * y);
}

static double most_of(Range a)
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
    return (Range){a.middle * b.middle, fabs(a.middle) * b.radius + a.radius * most_of(b)};
}

static Range between(double low, double high)
{
    return (Range){0.5 * (low + high), 0.5 * (high - low)};
}

static Range square(Range a)
{
    const double low = fmax(fabs(a.middle) - a.radius, 0.0), high = most_of(a);
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
    const Range one = inverse(a.of[0]), two = product(one, one);
    const Range bent = scaled(2.0, product(square(a.of[1]), product(two, one)));
    return (Jet){{one, scaled(-1.0, product(a.of[1], two)), sum(bent, scaled(-1.0, product(a.of[2], two)))}};
}

static Jet jet_root(Jet a)
{
    const Range value = root(a.of[0]), half = scaled(0.5, inverse(value));
    const Range bent = product(square(a.of[1]), product(half, square(half)));
    return (Jet){{value, product(a.of[1], half), sum(product(a.of[2], half), scaled(-2.0, bent))}};
}

/* constant + p cos(phi) + q sin(phi). */
static Jet turning(const Shape *shape, double constant, double p, double q)
{
    const double middle = 0.5 * (shape->low + shape->high), h = 0.5 * (shape->high - shape->low);
    const double c = cos(middle), s = sin(middle), value = p * c + q * s, slope = q * c - p * s;
    const double bent = 0.5 * hypot(p, q) * h * h;
    return (Jet){{{constant + value, fabs(slope) * h + bent},
                  {slope, fabs(value) * h + bent},
                  {-value, fabs(slope) * h + bent}}};
}

/* A constant plus the component of a vector that stands in the world along one that turns with the platform. */
static Jet seen(const Shape *shape, const double *standing, const double *turns, double constant)
{
    return turning(shape, standing[2] * turns[2] + constant, standing[0] * turns[0] + standing[1] * turns[1],
                   standing[1] * turns[0] - standing[0] * turns[1]);
}

static Jet fixed(double value)
{
    return (Jet){{{value, 0.0}, {0.0, 0.0}, {0.0, 0.0}}};
}

static void turned(double angle, const double *v, int64_t stride, double *out)
{
    const double c = cos(angle), s = sin(angle);
    out[0] = c * v[0] - s * v[stride];
    out[stride] = s * v[0] + c * v[stride];
    out[2 * stride] = v[2 * stride];
}

/* The curves of the pose from a platform angle, and u, r and t of the arm plane in the carried frame. */
static void seen_from(const Arm *arm, const double *R, const double *p, double angle, Curves *curves,
                      double directions[3][3])
{
    double own[9], point[3];
    for (int k = 0; k < 3; k++)
        turned(-angle, R + k, 3, own + k);
    turned(-angle, p, 1, point);
    curves_of(arm, own, point, curves);
    const double *plane[3] = {curves->u, curves->r, curves->t};
    for (int v = 0; v < 3; v++)
        for (int i = 0; i < 3; i++)
            directions[v][i] = dot(arm->B + 3 * i, plane[v]);
}

/* Cosine and sine of a link's angle to the line from shoulder to wrist, by the law of cosines. */
static void triangle(double own, double other, Jet distance, Jet reciprocal, Jet *cosine, Jet *sine)
{
    *cosine = jet_sum(jet_scaled(0.5 / own, distance), jet_scaled(0.5 * (own * own - other * other) / own, reciprocal));
    Jet squared = jet_scaled(-1.0, jet_product(*cosine, *cosine));
    squared.of[0] = sum((Range){1.0, 0.0}, scaled(-1.0, square(cosine->of[0])));
    *sine = jet_root(squared);
}

/* The arm plane's three directions along a vector, by how the middle's directions and the line are along it. */
static void plane_along(const Jet middle[3], Jet line, const Jet tilt[2], Jet found[3])
{
    const Jet both = jet_sum(middle[0], line);
    found[0] = line;
    for (int i = 0; i < 2; i++)
        found[1 + i] = jet_sum(middle[1 + i], jet_scaled(-1.0, jet_product(tilt[i], both)));
}

static Wave wave_of(Jet sine, Jet cosine, Jet constant)
{
    Wave wave = {sine, cosine, constant, {0.0, 0.0, 0.0}};
    for (int d = 0; d < 3; d++)
        wave.size[d] = length(sine.of[d].middle, cosine.of[d].middle);
    return wave;
}

void shape_of(const Arm *arm, const double *R, const double *p, double low, double high, Shape *shape)
{
    const double a = arm->upper_arm, b = arm->fore_arm, *S = arm->shoulder;
    double W[3], world[3][3], axis[3][3], tool[3][3];
    Curves curves;
    shape->low = low;
    shape->high = high;
    seen_from(arm, R, p, 0.5 * (low + high), &curves, shape->frame);
    for (int i = 0; i < 3; i++) {
        W[i] = p[i] + dot(R + 3 * i, arm->flange_wrist);
        turned(0.5 * (low + high), shape->frame[i], 1, world[i]);
        for (int j = 0; j < 3; j++) {
            axis[i][j] = arm->B[3 * j + i];
            tool[i][j] = dot(R + 3 * j, arm->C + 3 * i);
        }
    }
    /* The shoulder turns with the platform. */
    const double twice[3] = {-2.0 * W[0], -2.0 * W[1], -2.0 * W[2]};
    const Jet distance = jet_root(seen(shape, twice, S, dot(W, W) + dot(S, S)));
    const Range nearest = distance.of[0], nothing = {0.0, INFINITY};
    const int known = nearest.middle - nearest.radius > TINY;
    const Jet reciprocal = known ? jet_inverse(distance) : (Jet){{nothing, nothing, nothing}};
    Jet along[3], tilt[2], ca, sa, cf, sf;
    for (int i = 0; i < 3; i++) {
        const double back[3] = {-world[i][0], -world[i][1], -world[i][2]};
        along[i] = jet_product(seen(shape, back, S, dot(W, world[i])), reciprocal);
    }
    const Jet opening = jet_inverse(jet_sum(fixed(1.0), along[0]));
    for (int i = 0; i < 2; i++)
        tilt[i] = jet_product(along[1 + i], opening);
    triangle(a, b, distance, reciprocal, &ca, &sa);
    triangle(b, a, distance, reciprocal, &cf, &sf);
    shape->bend = jet_scaled(0.5 / (a * b), jet_product(distance, distance));
    shape->bend.of[0] = sum(scaled(0.5 / (a * b), square(distance.of[0])),
                            (Range){-0.5 * (a * a + b * b) / (a * b), 0.0});
    Jet own[3][3], k[3][3]; /* of u, r, t along the axes and along the tool */
    for (int i = 0; i < 3; i++) {
        Jet middle[3], stands[3];
        for (int v = 0; v < 3; v++) {
            middle[v] = seen(shape, world[v], axis[i], 0.0);
            stands[v] = fixed(dot(world[v], tool[i]));
        }
        const double back[3] = {-tool[i][0], -tool[i][1], -tool[i][2]};
        plane_along(middle, jet_product(seen(shape, W, axis[i], -dot(S, axis[i])), reciprocal), tilt, own[i]);
        plane_along(stands, jet_product(seen(shape, back, S, dot(W, tool[i])), reciprocal), tilt, k[i]);
    }
    const Range link[2][2] = {{ca.of[0], sa.of[0]}, {cf.of[0], sf.of[0]}};
    memcpy(shape->link, link, sizeof link);
    Wave *wave = shape->wave;
    const Jet zero = fixed(0.0), back = jet_scaled(-1.0, sf);
    for (int i = 0; i < 3; i++) {
        /* The upper arm along the axes: z, y, x; the forearm along those of the tool: z, y, -x. */
        const Jet *u = own[2 - i], *o = k[2 - i];
        wave[i] = wave_of(jet_product(sa, u[2]), jet_product(sa, u[1]), jet_product(ca, u[0]));
        const Jet bent = i == 2 ? sf : back, straight = i == 2 ? jet_scaled(-1.0, cf) : cf;
        wave[i ? 7 + i : 5] = wave_of(jet_product(bent, o[2]), jet_product(bent, o[1]), jet_product(straight, o[0]));
    }
    const Jet *z = own[2], *o = k[2];
    wave[3] = wave_of(z[1], jet_scaled(-1.0, z[2]), zero);
    wave[4] = wave_of(jet_product(ca, z[2]), jet_product(ca, z[1]), jet_scaled(-1.0, jet_product(sa, z[0])));
    wave[6] = wave_of(o[1], jet_scaled(-1.0, o[2]), zero);
    wave[7] = wave_of(jet_scaled(-1.0, jet_product(cf, o[2])), jet_scaled(-1.0, jet_product(cf, o[1])),
                      jet_product(back, o[0]));
}

/* The arm angle of the middle's reference direction after the smallest rotation in the world. */
static double carried_along(const double middle[3][3], double here[3][3], double turn)
{
    double u[3], r[3], t[3], carried[3];
    turned(turn, here[0], 1, u);
    turned(turn, here[1], 1, r);
    turned(turn, here[2], 1, t);
    const double along = dot(middle[1], u) / fmax(1.0 + dot(middle[0], u), 1e-12);
    for (int i = 0; i < 3; i++)
        carried[i] = middle[1][i] - along * (middle[0][i] + u[i]);
    return atan2(dot(carried, t), dot(carried, r));
}

void corners_of(const Arm *arm, const double *R, const double *p, const Shape *shape, int64_t parts, double *corner)
{
    for (int side = 0; side < 2; side++) {
        const double angle = side ? shape->high : shape->low;
        double directions[3][3];
        Curves curves;
        seen_from(arm, R, p, angle, &curves, directions);
        const double shift = carried_along(shape->frame, directions, angle - 0.5 * (shape->low + shape->high));
        for (int64_t k = 0; k < parts; k++) {
            const double psi = -PI + TURN * (double)k / (double)parts + shift;
            double q[4], theta[2], *own = corner + (side * parts + k) * JOINTS;
            angles_at(arm, &curves, sin(psi), cos(psi), q, theta);
            for (int j = 0; j < 4; j++)
                own[2 * j] = q[j];
            /* Where the first joint of a triple is chosen at will, the middle one may be an ulp below zero. */
            own[1] = fabs(theta[0]);
            own[3] = curves.bend;
            own[5] = fabs(theta[1]);
        }
    }
}

/* A wave over a part of the circle: its value, derivatives by the platform angle (1, 2) and by the arm angle (3, 4). */
typedef struct {
    Range of[5];
} Sample;

/* `size` is that of sine and cosine together. */
static Range over(Range sine, Range cosine, Range constant, double size, double s, double c, double h)
{
    const double slope = sine.middle * c - cosine.middle * s;
    return (Range){sine.middle * s + cosine.middle * c + constant.middle,
                   sine.radius + cosine.radius + constant.radius +
                       fmin(fabs(slope) * h + 0.5 * size * h * h, 2.0 * size)};
}

static Sample sampled(const Wave *wave, double s, double c, double h)
{
    Sample found;
    const Jet *a = &wave->sine, *b = &wave->cosine;
    const Range none = {0.0, 0.0};
    for (int i = 0; i < 3; i++)
        found.of[i] = over(a->of[i], b->of[i], wave->constant.of[i], wave->size[i], s, c, h);
    found.of[3] = over(scaled(-1.0, b->of[0]), a->of[0], none, wave->size[0], s, c, h);
    found.of[4] = over(scaled(-1.0, a->of[0]), scaled(-1.0, b->of[0]), none, wave->size[0], s, c, h);
    return found;
}

/* Sets what is known of a joint's derivatives; half-widths h. Returns whether they tell its values well. */
static int set_derivatives(Bends *bends, int joint, double sign, const Range first[DIRECTIONS],
                            const Range second[DIRECTIONS], const double h[DIRECTIONS])
{
    double slack = 0.0;
    bends->smooth[joint] = 1;
    for (int d = 0; d < DIRECTIONS; d++) {
        bends->second[d][joint] = scaled(sign, second[d]);
        slack += 0.5 * most_of(second[d]) * h[d] * h[d];
        bends->smooth[joint] &= most_of(first[d]) * h[d] < 0.5 * PI && most_of(second[d]) < INFINITY;
    }
    bends->value[joint] = (Range){0.0, INFINITY};
    return slack < WELL;
}

/* A triple of joints over a part of the circle. */
typedef struct {
    const Sample *cosine, *along, *outer[2], *inner[2]; /* of the middle joint; `along` is below in `inner` */
    Range size, weight, link[2];                        /* sine of the middle joint, its square's inverse; the link */
} Triple;

/* The arc tangent of one wave over another, by the platform angle; by the arm angle its derivatives are given. */
static void set_tangent(Bends *bends, const Arm *arm, int joint, const Triple *triple, const Sample *const wave[2],
                        Range first_psi, Range second_psi, const double h[DIRECTIONS])
{
    const double sign = arm->sign[joint];
    const Range n = wave[0]->of[0], d = wave[1]->of[0];
    const Range cross = sum(product(d, wave[0]->of[1]), scaled(-1.0, product(n, wave[1]->of[1])));
    const Range bent = sum(product(d, wave[0]->of[2]), scaled(-1.0, product(n, wave[1]->of[2])));
    const Range nearing = product(triple->weight, product(triple->cosine->of[0], triple->cosine->of[1]));
    const Range first = product(triple->weight, cross);
    const Range second = sum(product(triple->weight, bent), scaled(2.0, product(nearing, first)));
    if (set_derivatives(bends, joint, sign, (Range[]){first, first_psi}, (Range[]){second, second_psi}, h))
        return;
    const double size = length(n.middle, d.middle), away = length(n.radius, d.radius);
    bends->value[joint] = (Range){sign * (atan2(n.middle, d.middle) - arm->offset[joint]),
                                  away < size ? asin(away / size) : INFINITY};
}

/* The arc cosine of a wave, given the sine's range. */
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

/* The joints of a triple. The elbow's circle turns both links about the line from shoulder to wrist. With c the middle
   joint's cosine, e the wave `along`, and s, k sine and cosine of the link's angle to that line, the outer joint's
   derivative by the arm angle therefore is -s e / (1 - c²), and the inner one's k + s c e / (1 - c²); those of the
   wrist have the other sign. */
static void set_triple(Bends *bends, const Arm *arm, int wrist, Triple *triple, const double h[DIRECTIONS])
{
    const double sign = wrist ? -1.0 : 1.0;
    const Range c = triple->cosine->of[0], c_1 = triple->cosine->of[3];
    const Range e = triple->along->of[0], e_1 = triple->along->of[3];
    triple->weight = inverse(square(triple->size));
    const Range se = scaled(sign, product(triple->link[1], triple->weight));
    const Range near = product(product(c, c), triple->weight), turn = product(e, c_1);
    const Range more = product(turn, sum((Range){1.0, 0.0}, scaled(2.0, near)));
    const Range outer = sum(product(se, e_1), scaled(2.0, product(product(se, triple->weight), product(c, turn))));
    const Range inner = product(se, sum(product(e_1, c), more));
    set_tangent(bends, arm, JOINT[wrist][0], triple, triple->outer, scaled(-1.0, product(se, e)), scaled(-1.0, outer),
                h);
    set_cosine(bends, JOINT[wrist][1], triple->cosine, triple->size, h);
    set_tangent(bends, arm, JOINT[wrist][2], triple, triple->inner,
                sum(scaled(sign, triple->link[0]), product(se, product(c, e))), inner, h);
}

static Range narrower(Range a, Range b)
{
    return a.radius < b.radius ? a : b;
}

static Range length_of(const Sample *one, const Sample *other)
{
    return (Range){length(one->of[0].middle, other->of[0].middle), length(one->of[0].radius, other->of[0].radius)};
}

void bends_of(const Arm *arm, const Shape *shape, int64_t parts, Bends *bends)
{
    const double h[DIRECTIONS] = {0.5 * (shape->high - shape->low), PI / (double)parts};
    const Sample bend = {{shape->bend.of[0], shape->bend.of[1], shape->bend.of[2], {0.0, 0.0}, {0.0, 0.0}}};
    const Range bend_sine = root(sum((Range){1.0, 0.0}, scaled(-1.0, square(bend.of[0]))));
    for (int64_t k = 0; k < parts; k++) {
        const double psi = -PI + TURN * ((double)k + 0.5) / (double)parts, s = sin(psi), c = cos(psi);
        Sample sample[WAVES];
        for (int i = 0; i < WAVES; i++)
            sample[i] = sampled(shape->wave + i, s, c, h[1]);
        for (int wrist = 0; wrist < 2; wrist++) {
            const Sample *own = sample + 5 * wrist, *inner = own + (wrist ? 1 : 3), *outer = own + (wrist ? 3 : 1);
            Triple triple = {own, inner + 1, {outer, outer + 1}, {inner, inner + 1}, .link = {{0.0, 0.0}}};
            /* The sine of the middle joint, from whatever tells it best. */
            const Range own_sine = root(sum((Range){1.0, 0.0}, scaled(-1.0, square(own->of[0]))));
            triple.size = narrower(narrower(length_of(inner, inner + 1), length_of(outer, outer + 1)), own_sine);
            triple.link[0] = shape->link[wrist][0];
            triple.link[1] = shape->link[wrist][1];
            set_triple(bends + k, arm, wrist, &triple, h);
        }
        set_cosine(bends + k, 3, &bend, bend_sine, h);
    }
}

void spans_of(int64_t parts, const double h[DIRECTIONS], const double *corner, const Bends *bends, Span *span)
{
    for (int64_t k = 0; k < parts; k++) {
        const int64_t next = (k + 1) % parts;
        const double *at[CORNERS] = {corner + k * JOINTS, corner + next * JOINTS, corner + (parts + next) * JOINTS,
                                     corner + (parts + k) * JOINTS};
        for (int joint = 0; joint < JOINTS; joint++) {
            const Range value = bends[k].value[joint];
            Span *own = span + k * JOINTS + joint;
            *own = (Span){value.middle - value.radius - ROUNDING, value.middle + value.radius + ROUNDING};
            if (!bends[k].smooth[joint])
                continue;
            double change = 0.0, least = 0.0, most = 0.0, below = ROUNDING, above = ROUNDING;
            for (int c = 1; c < CORNERS; c++) {
                const double step = at[c][joint] - at[c - 1][joint];
                change += step - TURN * nearbyint(step / TURN);
                least = fmin(least, change);
                most = fmax(most, change);
            }
            for (int d = 0; d < DIRECTIONS; d++)
                add_slack(bends[k].second[d][joint], h[d], &below, &above);
            if (most - least + below + above < own->high - own->low)
                *own = (Span){at[0][joint] + least - below, at[0][joint] + most + above};
        }
    }
}
