/* Inverse kinematics of spherical-revolute-spherical arms, target by target: what `kinematics/srs` explains, and what
   the search asks of it. Angles in rad, lengths in m; joints counted from 0; matrices row by row. */

#include <math.h>
#include <stdint.h>

#include "srs.h"

enum { MOST_HALF_STEPS = 512, MOST_CUTS = 32 };

static const double REACH_SLACK = 1e-11, STRETCHED = 1e-14, ON_AXIS = 1e-12, NEAR_SINGULAR = 1e-4, SINGULAR = 1e-12,
                    LIMIT_SLACK = 1e-10;
static const int TURNING[4] = {0, 2, 4, 6};

static double wrap(double angle)
{
    const double wrapped = angle - TURN * ceil(angle / TURN - 0.5);
    if (wrapped <= -PI)
        return PI;
    return wrapped < PI ? wrapped : PI;
}

static void set(double *row, double a, double b, double c)
{
    row[0] = a;
    row[1] = b;
    row[2] = c;
}

static double at(const double *row, double sine, double cosine)
{
    return row[0] * sine + row[1] * cosine + row[2];
}

/* A triple that is singular at every arm angle: its first joint is constant, its last one has all of the turn. */
static void overwrite(double turning[2][2][3], const double rows[2][3], double theta)
{
    /* Short, so that the sine of the middle joint, which is their length, stays next to nothing. */
    set(turning[0][0], 0.0, 0.0, SINGULAR * SINGULAR * sin(theta));
    set(turning[0][1], 0.0, 0.0, SINGULAR * SINGULAR * cos(theta));
    for (int k = 0; k < 2; k++)
        set(turning[1][k], rows[k][0], rows[k][1], rows[k][2]);
}

void curves_of(const Arm *arm, const double *R, const double *p, Curves *c)
{
    double wrist[3], w[3], RC[9];
    for (int i = 0; i < 3; i++)
        wrist[i] = p[i] + dot(R + 3 * i, arm->flange_wrist) - arm->shoulder[i];
    for (int i = 0; i < 3; i++)
        w[i] = arm->B[i] * wrist[0] + arm->B[3 + i] * wrist[1] + arm->B[6 + i] * wrist[2];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            RC[3 * i + j] = dot(R + 3 * i, arm->C + 3 * j);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            c->R[3 * i + j] = arm->B[i] * RC[j] + arm->B[3 + i] * RC[3 + j] + arm->B[6 + i] * RC[6 + j];
    const double distance = sqrt(dot(w, w));
    const double reach = arm->upper_arm + arm->fore_arm, core = fabs(arm->upper_arm - arm->fore_arm);
    c->reachable = distance <= reach + REACH_SLACK && distance >= core - REACH_SLACK;
    double d = distance < core + STRETCHED ? core : distance;
    d = d > reach - STRETCHED ? reach : d;
    const double sine = sqrt((reach - d) * (reach + d) * (d - core) * (d + core));
    c->bend = atan2(sine / (2.0 * arm->upper_arm * arm->fore_arm),
                    (d * d - arm->upper_arm * arm->upper_arm - arm->fore_arm * arm->fore_arm) /
                        (2.0 * arm->upper_arm * arm->fore_arm));
    const double along = arm->upper_arm + arm->fore_arm * cos(c->bend), beside = arm->fore_arm * sin(c->bend);
    const int tiny = distance < REACH_SLACK;
    for (int i = 0; i < 3; i++)
        c->u[i] = tiny ? (i == 2) : w[i] / distance;
    const double x = c->u[0], y = c->u[1], z = c->u[2], rho = sqrt(x * x + y * y);
    const double cx = rho < ON_AXIS ? 1.0 : x / rho, cy = rho < ON_AXIS ? 0.0 : y / rho, v = 1.0 - z;
    set(c->r, 1.0 - v * cx * cx, -v * cx * cy, -x);
    set(c->t, -v * cx * cy, 1.0 - v * cy * cy, -y);
    const double a = tiny ? 0.5 * PI : atan2(beside, along), f = c->bend - a;
    c->cos_a = cos(a);
    c->sin_a = sin(a);
    c->cos_f = cos(f);
    c->sin_f = sin(f);
    const double *u = c->u, *r = c->r, *t = c->t, ca = c->cos_a, sa = c->sin_a, cf = c->cos_f, sf = c->sin_f;
    double ku[3], kr[3], kt[3];
    for (int k = 0; k < 3; k++) {
        const double column[3] = {c->R[k], c->R[3 + k], c->R[6 + k]};
        ku[k] = dot(u, column);
        kr[k] = dot(r, column);
        kt[k] = dot(t, column);
    }
    /* Entries of Z Y Z: (c1 s2, s1 s2, c2) is the last column, (-s2 c3, s2 s3, c2) the last row. */
    set(c->turning[0][0], sa * t[1], sa * r[1], ca * y);
    set(c->turning[0][1], sa * t[0], sa * r[0], ca * x);
    set(c->bending[0], sa * t[2], sa * r[2], ca * z);
    set(c->turning[1][0], r[2], -t[2], 0.0);
    set(c->turning[1][1], ca * t[2], ca * r[2], -sa * z);
    set(c->turning[2][0], kr[2], -kt[2], 0.0);
    set(c->turning[2][1], -cf * kt[2], -cf * kr[2], -sf * ku[2]);
    set(c->bending[1], -sf * kt[2], -sf * kr[2], cf * ku[2]);
    set(c->turning[3][0], -sf * kt[1], -sf * kr[1], cf * ku[1]);
    set(c->turning[3][1], sf * kt[0], sf * kr[0], -cf * ku[0]);
    if (sa + hypot(x, y) < SINGULAR) {
        const double rows[2][3] = {{-ca * t[1], -ca * r[1], sa * y}, {r[1], -t[1], 0.0}};
        overwrite(c->turning, rows, 0.0);
    }
    if (sf + hypot(kr[2], kt[2]) < SINGULAR) {
        const double s = sin(arm->offset[4]), o = cos(arm->offset[4]);
        double rows[2][3];
        for (int k = 0; k < 2; k++)
            set(rows[k], o * kr[k] + s * cf * kt[k], -o * kt[k] + s * cf * kr[k], s * sf * ku[k]);
        overwrite(c->turning + 2, rows, arm->offset[4]);
    }
    for (int i = 0; i < 4; i++) {
        const double offset = arm->offset[TURNING[i]];
        if (offset != 0.0) {
            const double o = cos(offset), s = sin(offset);
            for (int j = 0; j < 3; j++) {
                const double num = c->turning[i][0][j], den = c->turning[i][1][j];
                c->turning[i][0][j] = num * o - den * s;
                c->turning[i][1][j] = num * s + den * o;
            }
        }
        if (arm->sign[TURNING[i]] < 0.0)
            for (int j = 0; j < 3; j++)
                c->turning[i][0][j] *= -1.0;
    }
}

/* The outer joints of a triple whose middle joint is all but 0 or pi, and that one, with all digits. */
static void resolve(const Arm *arm, const Curves *c, int triple, double sine, double cosine, double q[4],
                    double middle[2])
{
    double h[3], m[3], M[3][3];
    for (int i = 0; i < 3; i++) {
        h[i] = c->r[i] * cosine + c->t[i] * sine;
        m[i] = c->t[i] * cosine - c->r[i] * sine;
    }
    if (triple == 0) {
        for (int i = 0; i < 3; i++)
            set(M[i], c->sin_a * c->u[i] - c->cos_a * h[i], -m[i], c->cos_a * c->u[i] + c->sin_a * h[i]);
    } else {
        double fore[3][3];
        for (int k = 0; k < 3; k++) {
            fore[0][k] = -c->cos_f * h[k] - c->sin_f * c->u[k];
            fore[1][k] = -m[k];
            fore[2][k] = c->cos_f * c->u[k] - c->sin_f * h[k];
        }
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                M[i][j] = fore[i][0] * c->R[j] + fore[i][1] * c->R[3 + j] + fore[i][2] * c->R[6 + j];
    }
    const int first = 2 * triple, last = first + 1;
    if (hypot(M[0][2], M[1][2]) < SINGULAR)
        q[first] = 0.0;
    const double theta = arm->sign[TURNING[first]] * q[first] + arm->offset[TURNING[first]];
    const double s = sin(theta), o = cos(theta);
    const double angle = atan2(o * M[1][0] - s * M[0][0], o * M[1][1] - s * M[0][1]);
    q[last] = wrap(arm->sign[TURNING[last]] * (angle - arm->offset[TURNING[last]]));
    middle[triple] = atan2(o * M[0][2] + s * M[1][2], M[2][2]);
}

void angles_at(const Arm *arm, const Curves *c, double sine, double cosine, double q[4], double middle[2])
{
    double size[2];
    for (int i = 0; i < 4; i++) {
        const double num = at(c->turning[i][0], sine, cosine), den = at(c->turning[i][1], sine, cosine);
        q[i] = atan2(num, den);
        if (q[i] <= -PI)
            q[i] = PI;
        if (i % 2 == 0)
            size[i / 2] = sqrt(num * num + den * den);
    }
    for (int j = 0; j < 2; j++)
        middle[j] = atan2(size[j], at(c->bending[j], sine, cosine));
    for (int j = 0; j < 2; j++)
        if (size[j] < NEAR_SINGULAR)
            resolve(arm, c, j, sine, cosine, q, middle);
}

/* Both values of every joint at an arm angle: as it is, and flipped. */
static void pairs_at(const Arm *arm, const Curves *c, double sine, double cosine, double pair[JOINTS][2])
{
    double q[4], middle[2];
    angles_at(arm, c, sine, cosine, q, middle);
    for (int i = 0; i < 4; i++) {
        const double opposite = q[i] - (q[i] > 0.0 ? PI : -PI);
        pair[TURNING[i]][0] = q[i];
        pair[TURNING[i]][1] = opposite <= -PI ? PI : opposite;
    }
    const double theta[3] = {middle[0], c->bend, middle[1]};
    for (int j = 0; j < 3; j++) {
        const double offset = arm->offset[2 * j + 1];
        pair[2 * j + 1][0] = offset == 0.0 ? theta[j] : wrap(theta[j] - offset);
        pair[2 * j + 1][1] = offset == 0.0 ? -theta[j] : wrap(-theta[j] - offset);
    }
}

/* Adds whole turns: nearest to a reference among those within limits; without one within, none. */
static double nearest_turn(const Arm *arm, int joint, double angle, double reference)
{
    const double lower = arm->lower[joint], upper = arm->upper[joint];
    if (lower > -PI + LIMIT_SLACK && upper < PI - LIMIT_SLACK)
        return angle;
    const double least = ceil((lower - LIMIT_SLACK - angle) / TURN), most = floor((upper + LIMIT_SLACK - angle) / TURN);
    if (!(least <= most))
        return angle;
    const double turns = nearbyint((reference - angle) / TURN);
    return angle + TURN * (turns < least ? least : turns > most ? most : turns);
}

/* Postures of targets: of one branch each, or of all eight where `branch` is null.

   R (targets, 9) and p (targets, 3); target, psi and branch (count,); q (count, 7) or (count, 8, 7), zeros where out of
   reach; reachable (count,). */
void srs_solve(const Arm *arm, const double *R, const double *p, const int64_t *target, const double *psi,
               const int64_t *branch, int64_t count, double *q, uint8_t *reachable)
{
    Curves curves;
    int64_t known = -1;
    for (int64_t k = 0; k < count; k++) {
        if (target[k] != known) {
            known = target[k];
            curves_of(arm, R + 9 * known, p + 3 * known, &curves);
        }
        double pair[JOINTS][2], *own = q + k * JOINTS * (branch ? 1 : BRANCHES);
        reachable[k] = (uint8_t)curves.reachable;
        if (curves.reachable)
            pairs_at(arm, &curves, sin(psi[k]), cos(psi[k]), pair);
        for (int b = 0; b < (branch ? 1 : BRANCHES); b++)
            for (int joint = 0; joint < JOINTS; joint++)
                own[b * JOINTS + joint] =
                    curves.reachable ? pair[joint][flips(joint, branch ? (int)branch[k] : b)] : 0.0;
    }
}

/* Joints along approach and retract of candidates, in `samples` each, the target between them.

   R (count, 9), p and z (count, 3): flange at the target, and the direction of the lines; branch (count,);
   psi (count, 3): at target, approach and retract; length (count, 2) of approach and retract; near (count, 7).
   path (count, 2 samples - 1, 7), from the target's turn on without jumps; ok (count,): within reach, no joint turns by
   more than `largest` between two samples. Where `lines` is 0, path is (count, 1, 7): the targets. */
void srs_lines(const Arm *arm, const double *R, const double *p, const double *z, const int64_t *branch,
               const double *psi, const double *length, const double *near, double largest, int64_t samples,
               int64_t lines, int64_t count, double *path, uint8_t *ok)
{
    const int64_t middle = lines ? samples - 1 : 0, number = 2 * middle + 1;
    for (int64_t k = 0; k < count; k++) {
        double *own = path + k * number * JOINTS;
        ok[k] = 1;
        for (int64_t i = 0; i < number; i++) {
            const int away = i > middle;
            const int64_t from = away ? i - middle : middle - i;
            const double share = middle ? (double)from / (double)middle : 0.0, depth = share * length[2 * k + away];
            const double end = length[2 * k + away] > 0.0 ? psi[3 * k + 1 + away] - psi[3 * k] : 0.0;
            const double angle = psi[3 * k] + share * end;
            double point[3], pair[JOINTS][2];
            Curves curves;
            for (int j = 0; j < 3; j++)
                point[j] = p[3 * k + j] - z[3 * k + j] * depth;
            curves_of(arm, R + 9 * k, point, &curves);
            ok[k] &= (uint8_t)curves.reachable;
            if (curves.reachable)
                pairs_at(arm, &curves, sin(angle), cos(angle), pair);
            for (int joint = 0; joint < JOINTS; joint++)
                own[i * JOINTS + joint] = curves.reachable ? pair[joint][flips(joint, (int)branch[k])] : 0.0;
        }
        for (int joint = 0; joint < JOINTS; joint++) {
            double *target = own + middle * JOINTS + joint;
            *target = nearest_turn(arm, joint, *target, near[k * JOINTS + joint]);
            for (int way = -1; way <= 1; way += 2)
                for (int64_t i = 1; i <= middle; i++) {
                    double *here = target + way * i * JOINTS;
                    double step = *here - here[-way * JOINTS];
                    step -= TURN * nearbyint(step / TURN);
                    ok[k] &= fabs(step) <= largest;
                    *here = here[-way * JOINTS] + step;
                }
        }
    }
}

/* What `srs_nodes` finds, row by row. */
typedef struct {
    int64_t *pose, *step, *branch; /* of the target */
    int64_t *swing;                /* half steps of the arm angle along approach and retract, (rows, 2) */
    double *q;                     /* joints at target, approach and retract, (rows, 3, 7) */
} Rows;

static int within(const Arm *arm, const double *q, int joints, double slack)
{
    for (int joint = 0; joint < joints; joint++)
        if (!(q[joint] >= arm->lower[joint] - slack && q[joint] <= arm->upper[joint] + slack))
            return 0;
    return 1;
}

/* Nodes of a stop: every pose, arm angle and branch within limits, with the swings along its lines that move joints
   least.

   R (poses, 9), points (poses, 3, 3): at target, approach and retract; steps: arm angles around the circle (half as
   far apart at lines' ends); reference, speed (7,); joints: how many of them have limits that count; swings: half steps
   to either side; largest: what a joint may turn along a line; ends: 1 where both lines are the same, else 2. Returns
   the number of rows; there may be poses * steps * 8. */
int64_t srs_nodes(const Arm *arm, const double *R, const double *points, int64_t poses, int64_t steps,
                  const double *reference, const double *speed, int64_t joints, int64_t swings, double largest,
                  int64_t ends, const Rows *rows)
{
    static _Thread_local double pair[3][MOST_HALF_STEPS][JOINTS][2];
    const int64_t around = 2 * steps;
    int64_t found = 0;
    for (int64_t k = 0; k < poses; k++) {
        int reachable = 1;
        for (int end = 0; end <= ends && reachable; end++) {
            const double *point = points + 9 * k + 3 * end;
            Curves curves;
            curves_of(arm, R + 9 * k, point, &curves);
            reachable = curves.reachable;
            for (int64_t i = 0; i < around && reachable; i += end ? 1 : 2) {
                const double psi = -PI + TURN * (double)i / (double)around;
                pairs_at(arm, &curves, sin(psi), cos(psi), pair[end][i]);
            }
        }
        for (int64_t i = 0; i < around && reachable; i += 2)
            for (int branch = 0; branch < BRANCHES; branch++) {
                double *target = rows->q + found * 3 * JOINTS;
                for (int joint = 0; joint < JOINTS; joint++)
                    target[joint] = nearest_turn(arm, joint, pair[0][i][joint][flips(joint, branch)], reference[joint]);
                if (!within(arm, target, (int)joints, LIMIT_SLACK))
                    continue;
                int serves = 1;
                for (int end = 1; end <= ends && serves; end++) {
                    double least = INFINITY;
                    for (int64_t s = 0; s <= 2 * swings; s++) {
                        /* 0, -1, 1, -2, 2, … */
                        const int64_t swing = s % 2 ? -(s + 1) / 2 : s / 2;
                        const int64_t there = ((i + swing) % around + around) % around;
                        double q[JOINTS], size = 0.0, most = 0.0;
                        for (int joint = 0; joint < JOINTS; joint++) {
                            double moved = pair[end][there][joint][flips(joint, branch)] - target[joint];
                            moved -= TURN * nearbyint(moved / TURN);
                            q[joint] = target[joint] + moved;
                            most = fabs(moved) > most ? fabs(moved) : most;
                            size = fabs(moved) / speed[joint] > size ? fabs(moved) / speed[joint] : size;
                        }
                        if (size < least && most <= largest && within(arm, q, (int)joints, 0.0)) {
                            least = size;
                            rows->swing[2 * found + end - 1] = swing;
                            for (int joint = 0; joint < JOINTS; joint++)
                                target[end * JOINTS + joint] = q[joint];
                        }
                    }
                    serves = isfinite(least);
                }
                if (!serves)
                    continue;
                if (ends == 1) {
                    rows->swing[2 * found + 1] = rows->swing[2 * found];
                    for (int joint = 0; joint < JOINTS; joint++)
                        target[2 * JOINTS + joint] = target[JOINTS + joint];
                }
                rows->pose[found] = k;
                rows->step[found] = i / 2;
                rows->branch[found] = branch;
                found++;
            }
    }
    return found;
}

static const double SAME = 1e-12, CROSSING = 1e-7, SINGULAR_BORDER = 1e-9, CONSTANT = 1e-20;

/* Limits that can bound a joint: none beyond one turn, one at exactly a turn. */
static int crossable(const Arm *arm, int joint, double limit[2])
{
    const double span = arm->upper[joint] - arm->lower[joint];
    limit[0] = arm->lower[joint];
    limit[1] = arm->upper[joint];
    return span > TURN + LIMIT_SLACK ? 0 : span >= TURN - LIMIT_SLACK ? 1 : 2;
}

/* Appends the roots of A sin x + B cos x + C = 0. */
static int add_roots(double a, double b, double c, double *cut, int number)
{
    const double size = hypot(a, b), square = (size - c) * (size + c);
    if (!(square >= 0.0))
        return number;
    /* acos(-C / size) by its tangent, which keeps its digits near double roots. */
    const double half = atan2(sqrt(square), -c), middle = atan2(a, b);
    cut[number] = wrap(middle - half);
    cut[number + 1] = wrap(middle + half);
    return number + 2;
}

/* All arm angles at which something may change, ascending. */
static int cuts_of(const Arm *arm, const Curves *c, double *cut)
{
    int number = 0;
    double limit[2];
    for (int i = 0; i < 4; i++)
        for (int k = crossable(arm, TURNING[i], limit) - 1; k >= 0; k--) {
            const double x = cos(limit[k]), y = sin(limit[k]);
            const double *num = c->turning[i][0], *den = c->turning[i][1];
            number = add_roots(num[0] * x - den[0] * y, num[1] * x - den[1] * y, num[2] * x - den[2] * y, cut, number);
        }
    for (int j = 0; j < 2; j++) {
        const int joint = 4 * j + 1;
        const double *row = c->bending[j];
        for (int k = crossable(arm, joint, limit) - 1; k >= 0; k--)
            number = add_roots(row[0], row[1], row[2] - cos(limit[k] + arm->offset[joint]), cut, number);
        /* A triple can only be singular where the cosine of its middle joint is extreme. */
        cut[number++] = wrap(atan2(row[0], row[1]));
        cut[number++] = wrap(atan2(-row[0], -row[1]));
    }
    for (int i = 1; i < number; i++)
        for (int k = i; k > 0 && cut[k] < cut[k - 1]; k--) {
            const double other = cut[k];
            cut[k] = cut[k - 1];
            cut[k - 1] = other;
        }
    int kept = 1;
    double before = cut[0];
    for (int i = 1; i < number; i++) {
        const double own = cut[i];
        if (!(own - before < SAME))
            cut[kept++] = own;
        before = own;
    }
    /* Both ends of the circle are one arm angle. */
    return kept > 1 && cut[0] + TURN - cut[kept - 1] < SAME ? kept - 1 : kept;
}

static int varies(const Curves *c, int joint)
{
    double most = 0.0;
    if (joint == 1 || joint == 5)
        for (int k = 0; k < 2; k++)
            most = fmax(most, fabs(c->bending[joint / 4][k]));
    else if (joint != 3)
        for (int k = 0; k < 4; k++)
            most = fmax(most, fabs(c->turning[joint / 2][k / 2][k % 2]));
    return most > CONSTANT;
}

/* Bits of the branches that satisfy a condition on both values of a joint. */
static unsigned branches_with(int joint, int plain, int flipped)
{
    unsigned bits = 0;
    for (int branch = 0; branch < BRANCHES; branch++)
        bits |= (unsigned)(flips(joint, branch) ? flipped : plain) << branch;
    return bits;
}

/* Bits of the branches that are within limits at an arm angle. */
static unsigned feasible_at(const Arm *arm, const Curves *c, double psi)
{
    double pair[JOINTS][2];
    unsigned bits = 255;
    pairs_at(arm, c, sin(psi), cos(psi), pair);
    for (int joint = 0; joint < JOINTS; joint++) {
        const double half = 0.5 * (arm->upper[joint] - arm->lower[joint]);
        if (2.0 * half >= TURN - LIMIT_SLACK)
            continue;
        const double middle = 0.5 * (arm->lower[joint] + arm->upper[joint]);
        int inside[2];
        for (int k = 0; k < 2; k++)
            inside[k] = fabs(wrap(pair[joint][k] - middle)) <= half + LIMIT_SLACK;
        bits &= branches_with(joint, inside[0], inside[1]);
    }
    return bits;
}

/* Bits of the branches that cannot be followed through an arm angle. */
static unsigned broken_at(const Arm *arm, const Curves *c, double psi)
{
    const double sine = sin(psi), cosine = cos(psi);
    double pair[JOINTS][2];
    unsigned clear = 255;
    for (int j = 0; j < 2; j++)
        if (varies(c, 4 * j + 1) && hypot(at(c->turning[2 * j][0], sine, cosine),
                                          at(c->turning[2 * j][1], sine, cosine)) < SINGULAR_BORDER)
            return 255;
    int known = 0;
    for (int joint = 0; joint < JOINTS; joint++) {
        /* A joint that stands at both its limits for all arm angles does not have to pass them. */
        if (!(fabs(arm->upper[joint] - arm->lower[joint] - TURN) <= LIMIT_SLACK) || !varies(c, joint))
            continue;
        if (!known)
            pairs_at(arm, c, sine, cosine, pair);
        known = 1;
        int away[2];
        for (int k = 0; k < 2; k++)
            away[k] = fabs(wrap(pair[joint][k] - arm->lower[joint])) >= CROSSING;
        clear &= branches_with(joint, away[0], away[1]);
    }
    return ~clear & 255;
}

/* Intervals of arm angles within limits, see `arm_angle_intervals`, of flange poses, R (count, 9) and p (count, 3).

   start and end (count, 8, MOST_CUTS), NaN beyond number (count, 8). */
void srs_intervals(const Arm *arm, const double *R, const double *p, int64_t count, double *start, double *end,
                   int64_t *number)
{
    for (int64_t k = 0; k < count; k++) {
        double cut[MOST_CUTS + 1];
        unsigned ok[MOST_CUTS], broken[MOST_CUTS];
        Curves c;
        int arcs = 0;
        curves_of(arm, R + 9 * k, p + 3 * k, &c);
        if (c.reachable) {
            arcs = cuts_of(arm, &c, cut);
            cut[arcs] = cut[0] + TURN;
            for (int i = 0; i < arcs; i++) {
                ok[i] = feasible_at(arm, &c, 0.5 * (cut[i] + cut[i + 1]));
                broken[i] = ok[i] ? broken_at(arm, &c, cut[i]) : 0;
            }
        }
        for (int branch = 0; branch < BRANCHES; branch++) {
            const unsigned bit = 1u << branch;
            double *first = start + (BRANCHES * k + branch) * MOST_CUTS, *last = end + (BRANCHES * k + branch) * MOST_CUTS;
            int found = 0, any = 0;
            for (int i = 0; i < arcs; i++) {
                any |= (ok[i] & bit) != 0;
                if (!(ok[i] & bit) || ((ok[(i + arcs - 1) % arcs] & bit) && !(broken[i] & bit)))
                    continue;
                int j = i;
                while ((ok[(j + 1) % arcs] & bit) && !(broken[(j + 1) % arcs] & bit))
                    j++;
                first[found] = cut[i];
                last[found++] = j < arcs ? cut[j + 1] : cut[j - arcs + 1] + TURN;
            }
            if (any && !found) {
                first[0] = -PI;
                last[0] = PI;
                found = 1;
            }
            number[BRANCHES * k + branch] = found;
            for (int i = found; i < MOST_CUTS; i++)
                first[i] = last[i] = NAN;
        }
    }
}
