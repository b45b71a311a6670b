/* Inverse kinematics of spherical-revolute-spherical arms: postures, lines, nodes and arm angle intervals.

   Method: `kinematics/srs`. Angles in rad, lengths in m; joints are counted from 0; matrices are row-major. */

#include <math.h>
#include <stdint.h>

#include "srs.h"

enum { MAX_HALF_STEPS = 512, MAX_CUTS = 32 };

static const double REACH_SLACK = 1e-11, STRETCHED = 1e-14, ON_AXIS = 1e-12, NEAR_SINGULAR = 1e-4, SINGULAR = 1e-12,
                    LIMIT_SLACK = 1e-10;
static const int TURNING[4] = {0, 2, 4, 6};

/* Wrap an angle to (-pi, pi]. */
static double wrap(double angle)
{
    const double wrapped = angle - TURN * ceil(angle / TURN - 0.5);
    if (wrapped <= -PI)
        return PI;
    return wrapped < PI ? wrapped : PI;
}

/* Set a row of coefficients. */
static void set_row(double *row, double a, double b, double c)
{
    row[0] = a;
    row[1] = b;
    row[2] = c;
}

/* Evaluate sine and cosine coefficients and a constant at an arm angle. */
static double evaluate(const double *row, double sine, double cosine)
{
    return row[0] * sine + row[1] * cosine + row[2];
}

/* Overwrite a triple that is singular at every arm angle: its last joint takes the rotation. */
static void overwrite_singular(double turning[2][2][3], const double rows[2][3], double theta)
{
    /* The length of these coefficients is the sine of the middle joint, which has to remain near zero. */
    set_row(turning[0][0], 0.0, 0.0, SINGULAR * SINGULAR * sin(theta));
    set_row(turning[0][1], 0.0, 0.0, SINGULAR * SINGULAR * cos(theta));
    for (int k = 0; k < 2; k++)
        set_row(turning[1][k], rows[k][0], rows[k][1], rows[k][2]);
}

void compute_curves(const Arm *arm, const double *R, const double *p, Curves *c)
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
    const double along_line = arm->upper_arm + arm->fore_arm * cos(c->bend), across_line = arm->fore_arm * sin(c->bend);
    const int is_zero = distance < REACH_SLACK;
    for (int i = 0; i < 3; i++)
        c->u[i] = is_zero ? (i == 2) : w[i] / distance;
    const double x = c->u[0], y = c->u[1], z = c->u[2], rho = sqrt(x * x + y * y);
    const double cx = rho < ON_AXIS ? 1.0 : x / rho, cy = rho < ON_AXIS ? 0.0 : y / rho, v = 1.0 - z;
    set_row(c->r, 1.0 - v * cx * cx, -v * cx * cy, -x);
    set_row(c->t, -v * cx * cy, 1.0 - v * cy * cy, -y);
    const double a = is_zero ? 0.5 * PI : atan2(across_line, along_line), f = c->bend - a;
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
    set_row(c->turning[0][0], sa * t[1], sa * r[1], ca * y);
    set_row(c->turning[0][1], sa * t[0], sa * r[0], ca * x);
    set_row(c->bending[0], sa * t[2], sa * r[2], ca * z);
    set_row(c->turning[1][0], r[2], -t[2], 0.0);
    set_row(c->turning[1][1], ca * t[2], ca * r[2], -sa * z);
    set_row(c->turning[2][0], kr[2], -kt[2], 0.0);
    set_row(c->turning[2][1], -cf * kt[2], -cf * kr[2], -sf * ku[2]);
    set_row(c->bending[1], -sf * kt[2], -sf * kr[2], cf * ku[2]);
    set_row(c->turning[3][0], -sf * kt[1], -sf * kr[1], cf * ku[1]);
    set_row(c->turning[3][1], sf * kt[0], sf * kr[0], -cf * ku[0]);
    if (sa + hypot(x, y) < SINGULAR) {
        const double rows[2][3] = {{-ca * t[1], -ca * r[1], sa * y}, {r[1], -t[1], 0.0}};
        overwrite_singular(c->turning, rows, 0.0);
    }
    if (sf + hypot(kr[2], kt[2]) < SINGULAR) {
        const double s = sin(arm->offset[4]), o = cos(arm->offset[4]);
        double rows[2][3];
        for (int k = 0; k < 2; k++)
            set_row(rows[k], o * kr[k] + s * cf * kt[k], -o * kt[k] + s * cf * kr[k], s * sf * ku[k]);
        overwrite_singular(c->turning + 2, rows, arm->offset[4]);
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

/* Solve a triple whose middle joint is almost 0 or pi in full precision. */
static void solve_near_singular(const Arm *arm, const Curves *c, int triple, double sine, double cosine, double q[4],
                                double middle[2])
{
    double h[3], m[3], M[3][3];
    for (int i = 0; i < 3; i++) {
        h[i] = c->r[i] * cosine + c->t[i] * sine;
        m[i] = c->t[i] * cosine - c->r[i] * sine;
    }
    if (triple == 0) {
        for (int i = 0; i < 3; i++)
            set_row(M[i], c->sin_a * c->u[i] - c->cos_a * h[i], -m[i], c->cos_a * c->u[i] + c->sin_a * h[i]);
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
        const double num = evaluate(c->turning[i][0], sine, cosine), den = evaluate(c->turning[i][1], sine, cosine);
        q[i] = atan2(num, den);
        if (q[i] <= -PI)
            q[i] = PI;
        if (i % 2 == 0)
            size[i / 2] = sqrt(num * num + den * den);
    }
    for (int j = 0; j < 2; j++)
        middle[j] = atan2(size[j], evaluate(c->bending[j], sine, cosine));
    for (int j = 0; j < 2; j++)
        if (size[j] < NEAR_SINGULAR)
            solve_near_singular(arm, c, j, sine, cosine, q, middle);
}

/* Compute both values of every joint at an arm angle, plain and flipped. */
static void joint_values(const Arm *arm, const Curves *c, double sine, double cosine, double pair[JOINTS][2])
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

/* Add whole turns so that an angle is nearest to a reference within limits; none if no turn is within limits. */
static double nearest_turn(const Arm *arm, int joint, double angle, double reference)
{
    const double lower = arm->lower[joint], upper = arm->upper[joint];
    if (lower > -PI + LIMIT_SLACK && upper < PI - LIMIT_SLACK)
        return angle;
    const double min_turns = ceil((lower - LIMIT_SLACK - angle) / TURN);
    const double max_turns = floor((upper + LIMIT_SLACK - angle) / TURN);
    if (!(min_turns <= max_turns))
        return angle;
    const double turns = nearbyint((reference - angle) / TURN);
    return angle + TURN * (turns < min_turns ? min_turns : turns > max_turns ? max_turns : turns);
}

/* Compute postures of targets at arm angles, in one branch each or, if `branch` is null, in all eight.

   R, p: flange poses, (targets, 9) and (targets, 3). target, psi, branch: target index, arm angle and branch, (count,).
   q: joints, (count, 7) or (count, 8, 7), zero if out of reach. reachable: (count,). */
void srs_solve(const Arm *arm, const double *R, const double *p, const int64_t *target, const double *psi,
               const int64_t *branch, int64_t count, double *q, uint8_t *reachable)
{
    Curves curves;
    int64_t current = -1;
    for (int64_t k = 0; k < count; k++) {
        if (target[k] != current) {
            current = target[k];
            compute_curves(arm, R + 9 * current, p + 3 * current, &curves);
        }
        double pair[JOINTS][2], *row = q + k * JOINTS * (branch ? 1 : BRANCHES);
        reachable[k] = (uint8_t)curves.reachable;
        if (curves.reachable)
            joint_values(arm, &curves, sin(psi[k]), cos(psi[k]), pair);
        for (int b = 0; b < (branch ? 1 : BRANCHES); b++)
            for (int joint = 0; joint < JOINTS; joint++)
                row[b * JOINTS + joint] =
                    curves.reachable ? pair[joint][flips(joint, branch ? (int)branch[k] : b)] : 0.0;
    }
}

/* Compute the joint paths of candidates along approach and retract, with `samples` each and the target in between.

   R, p: flange pose at the target, (count, 9), (count, 3). outward: directions of approach and retract from there,
   (count, 2, 3). branch: (count,).
   psi: arm angles at target, approach and retract, (count, 3). length: of approach and retract, (count, 2).
   reference: the target's joints are on the turn nearest to these, (count, 7).
   max_step: largest change of a joint between two samples.
   path: continuous from the target's turn on, (count, 2 samples - 1, 7); if `lines` is 0, the targets, (count, 1, 7).
   ok: whether all samples are within reach and all changes within max_step, (count,). */
void srs_lines(const Arm *arm, const double *R, const double *p, const double *outward, const int64_t *branch,
               const double *psi, const double *length, const double *reference, double max_step, int64_t samples,
               int64_t lines, int64_t count, double *path, uint8_t *ok)
{
    const int64_t middle = lines ? samples - 1 : 0, points = 2 * middle + 1;
    for (int64_t k = 0; k < count; k++) {
        double *joints = path + k * points * JOINTS;
        ok[k] = 1;
        for (int64_t i = 0; i < points; i++) {
            const int on_retract = i > middle;
            const int64_t from = on_retract ? i - middle : middle - i;
            const double fraction = middle ? (double)from / (double)middle : 0.0;
            const double depth = fraction * length[2 * k + on_retract];
            const double psi_change = length[2 * k + on_retract] > 0.0 ? psi[3 * k + 1 + on_retract] - psi[3 * k] : 0.0;
            const double angle = psi[3 * k] + fraction * psi_change;
            double flange[3], pair[JOINTS][2];
            Curves curves;
            for (int j = 0; j < 3; j++)
                flange[j] = p[3 * k + j] + outward[6 * k + 3 * on_retract + j] * depth;
            compute_curves(arm, R + 9 * k, flange, &curves);
            ok[k] &= (uint8_t)curves.reachable;
            if (curves.reachable)
                joint_values(arm, &curves, sin(angle), cos(angle), pair);
            for (int joint = 0; joint < JOINTS; joint++)
                joints[i * JOINTS + joint] = curves.reachable ? pair[joint][flips(joint, (int)branch[k])] : 0.0;
        }
        for (int joint = 0; joint < JOINTS; joint++) {
            double *target = joints + middle * JOINTS + joint;
            *target = nearest_turn(arm, joint, *target, reference[k * JOINTS + joint]);
            for (int direction = -1; direction <= 1; direction += 2)
                for (int64_t i = 1; i <= middle; i++) {
                    double *position = target + direction * i * JOINTS;
                    double step = *position - position[-direction * JOINTS];
                    step -= TURN * nearbyint(step / TURN);
                    ok[k] &= fabs(step) <= max_step;
                    *position = position[-direction * JOINTS] + step;
                }
        }
    }
}

/* Nodes found by `srs_nodes`. */
typedef struct {
    int64_t *pose, *step, *branch; /* pose, arm angle and branch at the target */
    int64_t *swing;                /* change of the arm angle along approach and retract in half steps, (rows, 2) */
    double *q;                     /* joints at target, approach and retract, (rows, 3, 7) */
} Rows;

/* Check whether the first `joints` joints are within limits. */
static int is_within_limits(const Arm *arm, const double *q, int joints, double slack)
{
    for (int joint = 0; joint < joints; joint++)
        if (!(q[joint] >= arm->lower[joint] - slack && q[joint] <= arm->upper[joint] + slack))
            return 0;
    return 1;
}

/* Compute the nodes of a stop: all poses, arm angles and branches within limits, each with its fastest lines.

   R: flange rotations, (poses, 9). points: flange positions at target, approach and retract, (poses, 3, 3).
   steps: arm angles at the target around the circle; at the ends of lines they are half as far apart.
   reference: joints that select the turns, (7,). speed: joint velocity limits, (7,).
   joints: number of joints with limits. swings: largest change of the arm angle along a line in half steps.
   max_change: largest change of a joint along a line.
   ends: 1 if both lines are the same, else 2. rows: room for poses * steps * 8.
   Returns the number of rows. */
int64_t srs_nodes(const Arm *arm, const double *R, const double *points, int64_t poses, int64_t steps,
                  const double *reference, const double *speed, int64_t joints, int64_t swings, double max_change,
                  int64_t ends, const Rows *rows)
{
    static _Thread_local double pair[3][MAX_HALF_STEPS][JOINTS][2];
    const int64_t half_steps = 2 * steps;
    int64_t row = 0;
    for (int64_t k = 0; k < poses; k++) {
        int reachable = 1;
        for (int end = 0; end <= ends && reachable; end++) {
            const double *point = points + 9 * k + 3 * end;
            Curves curves;
            compute_curves(arm, R + 9 * k, point, &curves);
            reachable = curves.reachable;
            for (int64_t i = 0; i < half_steps && reachable; i += end ? 1 : 2) {
                const double psi = -PI + TURN * (double)i / (double)half_steps;
                joint_values(arm, &curves, sin(psi), cos(psi), pair[end][i]);
            }
        }
        for (int64_t i = 0; i < half_steps && reachable; i += 2)
            for (int branch = 0; branch < BRANCHES; branch++) {
                double *target = rows->q + row * 3 * JOINTS;
                for (int joint = 0; joint < JOINTS; joint++)
                    target[joint] = nearest_turn(arm, joint, pair[0][i][joint][flips(joint, branch)], reference[joint]);
                if (!is_within_limits(arm, target, (int)joints, LIMIT_SLACK))
                    continue;
                int is_feasible = 1;
                for (int end = 1; end <= ends && is_feasible; end++) {
                    double min_time = INFINITY;
                    for (int64_t s = 0; s <= 2 * swings; s++) {
                        /* 0, -1, 1, -2, 2, … */
                        const int64_t swing = s % 2 ? -(s + 1) / 2 : s / 2;
                        const int64_t index = ((i + swing) % half_steps + half_steps) % half_steps;
                        double q[JOINTS], time = 0.0, largest_change = 0.0;
                        for (int joint = 0; joint < JOINTS; joint++) {
                            double change = pair[end][index][joint][flips(joint, branch)] - target[joint];
                            change -= TURN * nearbyint(change / TURN);
                            q[joint] = target[joint] + change;
                            largest_change = fabs(change) > largest_change ? fabs(change) : largest_change;
                            time = fabs(change) / speed[joint] > time ? fabs(change) / speed[joint] : time;
                        }
                        if (time < min_time && largest_change <= max_change &&
                            is_within_limits(arm, q, (int)joints, 0.0)) {
                            min_time = time;
                            rows->swing[2 * row + end - 1] = swing;
                            for (int joint = 0; joint < JOINTS; joint++)
                                target[end * JOINTS + joint] = q[joint];
                        }
                    }
                    is_feasible = isfinite(min_time);
                }
                if (!is_feasible)
                    continue;
                if (ends == 1) {
                    rows->swing[2 * row + 1] = rows->swing[2 * row];
                    for (int joint = 0; joint < JOINTS; joint++)
                        target[2 * JOINTS + joint] = target[JOINTS + joint];
                }
                rows->pose[row] = k;
                rows->step[row] = i / 2;
                rows->branch[row] = branch;
                row++;
            }
    }
    return row;
}

static const double ANGLE_TOLERANCE = 1e-12, CROSSING = 1e-7, SINGULAR_BORDER = 1e-9, CONSTANT = 1e-20;

/* Count the limits that a joint can cross: none if they span more than a turn, one at exactly a turn, else two. */
static int crossable(const Arm *arm, int joint, double limit[2])
{
    const double span = arm->upper[joint] - arm->lower[joint];
    limit[0] = arm->lower[joint];
    limit[1] = arm->upper[joint];
    return span > TURN + LIMIT_SLACK ? 0 : span >= TURN - LIMIT_SLACK ? 1 : 2;
}

/* Append the roots of a sin x + b cos x + c = 0; return their new number. */
static int add_roots(double a, double b, double c, double *cut, int count)
{
    const double size = hypot(a, b), square = (size - c) * (size + c);
    if (!(square >= 0.0))
        return count;
    /* acos(-c / size) by its tangent, which keeps full precision near double roots. */
    const double half = atan2(sqrt(square), -c), middle = atan2(a, b);
    cut[count] = wrap(middle - half);
    cut[count + 1] = wrap(middle + half);
    return count + 2;
}

/* Compute all arm angles at which feasibility may change, ascending; return their number. */
static int compute_cuts(const Arm *arm, const Curves *c, double *cut)
{
    int count = 0;
    double limit[2];
    for (int i = 0; i < 4; i++)
        for (int k = crossable(arm, TURNING[i], limit) - 1; k >= 0; k--) {
            const double x = cos(limit[k]), y = sin(limit[k]);
            const double *num = c->turning[i][0], *den = c->turning[i][1];
            count = add_roots(num[0] * x - den[0] * y, num[1] * x - den[1] * y, num[2] * x - den[2] * y, cut, count);
        }
    for (int j = 0; j < 2; j++) {
        const int joint = 4 * j + 1;
        const double *row = c->bending[j];
        for (int k = crossable(arm, joint, limit) - 1; k >= 0; k--)
            count = add_roots(row[0], row[1], row[2] - cos(limit[k] + arm->offset[joint]), cut, count);
        /* A triple can be singular only at an extremum of the cosine of its middle joint. */
        cut[count++] = wrap(atan2(row[0], row[1]));
        cut[count++] = wrap(atan2(-row[0], -row[1]));
    }
    for (int i = 1; i < count; i++)
        for (int k = i; k > 0 && cut[k] < cut[k - 1]; k--) {
            const double swapped = cut[k];
            cut[k] = cut[k - 1];
            cut[k - 1] = swapped;
        }
    int distinct = 1;
    double previous = cut[0];
    for (int i = 1; i < count; i++) {
        const double angle = cut[i];
        if (!(angle - previous < ANGLE_TOLERANCE))
            cut[distinct++] = angle;
        previous = angle;
    }
    /* Both ends of the circle are the same arm angle. */
    return distinct > 1 && cut[0] + TURN - cut[distinct - 1] < ANGLE_TOLERANCE ? distinct - 1 : distinct;
}

/* Check whether a joint depends on the arm angle. */
static int varies(const Curves *c, int joint)
{
    double amplitude = 0.0;
    if (joint == 1 || joint == 5)
        for (int k = 0; k < 2; k++)
            amplitude = fmax(amplitude, fabs(c->bending[joint / 4][k]));
    else if (joint != 3)
        for (int k = 0; k < 4; k++)
            amplitude = fmax(amplitude, fabs(c->turning[joint / 2][k / 2][k % 2]));
    return amplitude > CONSTANT;
}

/* Compute the bits of the branches whose value of a joint satisfies a condition. */
static unsigned branches_with(int joint, int plain, int flipped)
{
    unsigned bits = 0;
    for (int branch = 0; branch < BRANCHES; branch++)
        bits |= (unsigned)(flips(joint, branch) ? flipped : plain) << branch;
    return bits;
}

/* Compute the bits of the branches within limits at an arm angle. */
static unsigned feasible_at(const Arm *arm, const Curves *c, double psi)
{
    double pair[JOINTS][2];
    unsigned bits = 255;
    joint_values(arm, c, sin(psi), cos(psi), pair);
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

/* Compute the bits of the branches that are not continuous at an arm angle. */
static unsigned discontinuous_at(const Arm *arm, const Curves *c, double psi)
{
    const double sine = sin(psi), cosine = cos(psi);
    double pair[JOINTS][2];
    unsigned continuous = 255;
    for (int j = 0; j < 2; j++)
        if (varies(c, 4 * j + 1) && hypot(evaluate(c->turning[2 * j][0], sine, cosine),
                                          evaluate(c->turning[2 * j][1], sine, cosine)) < SINGULAR_BORDER)
            return 255;
    int is_computed = 0;
    for (int joint = 0; joint < JOINTS; joint++) {
        /* A joint that does not move cannot cross its limits. */
        if (!(fabs(arm->upper[joint] - arm->lower[joint] - TURN) <= LIMIT_SLACK) || !varies(c, joint))
            continue;
        if (!is_computed)
            joint_values(arm, c, sine, cosine, pair);
        is_computed = 1;
        int off_limit[2];
        for (int k = 0; k < 2; k++)
            off_limit[k] = fabs(wrap(pair[joint][k] - arm->lower[joint])) >= CROSSING;
        continuous &= branches_with(joint, off_limit[0], off_limit[1]);
    }
    return ~continuous & 255;
}

/* Compute the intervals of arm angles within limits of flange poses, as `arm_angle_intervals` in Python.

   R, p: flange poses, (count, 9) and (count, 3). start, end: (count, 8, MAX_CUTS), NaN beyond `number`, (count, 8). */
void srs_intervals(const Arm *arm, const double *R, const double *p, int64_t count, double *start, double *end,
                   int64_t *number)
{
    for (int64_t k = 0; k < count; k++) {
        double cut[MAX_CUTS + 1];
        unsigned ok[MAX_CUTS], broken[MAX_CUTS];
        Curves c;
        int arcs = 0;
        compute_curves(arm, R + 9 * k, p + 3 * k, &c);
        if (c.reachable) {
            arcs = compute_cuts(arm, &c, cut);
            cut[arcs] = cut[0] + TURN;
            for (int i = 0; i < arcs; i++) {
                ok[i] = feasible_at(arm, &c, 0.5 * (cut[i] + cut[i + 1]));
                broken[i] = ok[i] ? discontinuous_at(arm, &c, cut[i]) : 0;
            }
        }
        for (int branch = 0; branch < BRANCHES; branch++) {
            const unsigned bit = 1u << branch;
            double *first = start + (BRANCHES * k + branch) * MAX_CUTS;
            double *last = end + (BRANCHES * k + branch) * MAX_CUTS;
            int intervals = 0, is_feasible = 0;
            for (int i = 0; i < arcs; i++) {
                is_feasible |= (ok[i] & bit) != 0;
                if (!(ok[i] & bit) || ((ok[(i + arcs - 1) % arcs] & bit) && !(broken[i] & bit)))
                    continue;
                int j = i;
                while ((ok[(j + 1) % arcs] & bit) && !(broken[(j + 1) % arcs] & bit))
                    j++;
                first[intervals] = cut[i];
                last[intervals++] = j < arcs ? cut[j + 1] : cut[j - arcs + 1] + TURN;
            }
            if (is_feasible && !intervals) {
                first[0] = -PI;
                last[0] = PI;
                intervals = 1;
            }
            number[BRANCHES * k + branch] = intervals;
            for (int i = intervals; i < MAX_CUTS; i++)
                first[i] = last[i] = NAN;
        }
    }
}
