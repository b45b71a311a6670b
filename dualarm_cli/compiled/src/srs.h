/* Kinematics of spherical-revolute-spherical arms. Angles in rad, lengths in m. */

#ifndef SRS_H
#define SRS_H

#define PI 3.141592653589793
#define TURN (2.0 * PI)

enum { JOINTS = 7, BRANCHES = 8 };

/* Geometry and limits of an arm: doubles only, because Python passes it as one array. */
typedef struct {
    double B[9], C[9];                   /* frames of the canonical chain */
    double shoulder[3], flange_wrist[3]; /* shoulder in the base frame, wrist in the flange frame */
    double upper_arm, fore_arm;          /* lengths of the links */
    double sign[JOINTS], offset[JOINTS]; /* of the canonical joints */
    double lower[JOINTS], upper[JOINTS]; /* position limits */
} Arm;

/* Joints as functions of the arm angle for one flange pose, as `ArmPlane` and `ArmAngleCurves` in Python. */
typedef struct {
    double u[3], r[3], t[3], cos_a, sin_a, cos_f, sin_f, bend, R[9];
    double turning[4][2][3], bending[2][3];
    int reachable;
} Curves;

static inline double dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Check whether a branch takes the second of a joint's two values. */
static inline int flips(int joint, int branch)
{
    static const int flipped_by[JOINTS] = {2, 2, 6, 4, 5, 1, 1};
    const int bits = branch & flipped_by[joint];
    return ((bits >> 2) ^ (bits >> 1) ^ bits) & 1;
}

/* Compute the curves of a flange pose in the base frame. */
void compute_curves(const Arm *arm, const double *R, const double *p, Curves *curves);

/* Compute joints 1, 3, 5 and 7 at an arm angle, in the branch with non-negative theta2 and theta6, and these. */
void angles_at(const Arm *arm, const Curves *curves, double sine, double cosine, double q[4], double middle[2]);

#endif
