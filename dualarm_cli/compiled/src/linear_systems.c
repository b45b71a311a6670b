/* Stacks of small dense systems: Gaussian elimination, one-sided Jacobi rotations, polynomial roots. */

#include <math.h>
#include <stdint.h>

enum { MAX_SWEEPS = 60, MAX_ROUNDS = 200 };

/* Solve A X = B in place by Gaussian elimination with partial pivoting; return the determinant, 0 if singular.

   a: A, overwritten, (n, n). x: B, becomes X, (n, m). */
static double eliminate(int64_t n, int64_t m, double *a, double *x) {
    double determinant = 1.0;
    for (int64_t c = 0; c < n; c++) {
        int64_t pivot_row = c;
        for (int64_t r = c + 1; r < n; r++)
            if (fabs(a[r * n + c]) > fabs(a[pivot_row * n + c])) pivot_row = r;
        double pivot = a[pivot_row * n + c];
        determinant *= pivot_row == c ? pivot : -pivot;
        if (pivot == 0.0) return 0.0;
        if (pivot_row != c) {
            for (int64_t j = 0; j < n; j++) {
                double swapped = a[c * n + j];
                a[c * n + j] = a[pivot_row * n + j], a[pivot_row * n + j] = swapped;
            }
            for (int64_t j = 0; j < m; j++) {
                double swapped = x[c * m + j];
                x[c * m + j] = x[pivot_row * m + j], x[pivot_row * m + j] = swapped;
            }
        }
        for (int64_t r = c + 1; r < n; r++) {
            double factor = a[r * n + c] / pivot;
            if (factor == 0.0) continue;
            for (int64_t j = c + 1; j < n; j++) a[r * n + j] -= factor * a[c * n + j];
            for (int64_t j = 0; j < m; j++) x[r * m + j] -= factor * x[c * m + j];
        }
    }
    for (int64_t c = n - 1; c >= 0; c--) {
        for (int64_t j = 0; j < m; j++) {
            for (int64_t k = c + 1; k < n; k++) x[c * m + j] -= a[c * n + k] * x[k * m + j];
            x[c * m + j] /= a[c * n + c];
        }
    }
    return determinant;
}

/* Solve `count` systems in place: a (count, n, n) is overwritten, x (count, n, m) holds right sides, then solutions. */
void dualarm_solve(int64_t count, int64_t n, int64_t m, double *a, double *x, double *determinant) {
    for (int64_t s = 0; s < count; s++)
        determinant[s] = eliminate(n, m, a + s * n * n, x + s * n * m);
}

/* Rotate the rows of a (n, m) until they are orthogonal, and accumulate the rotations in v (n, n) (Hestenes 1958). */
static void orthogonalise(int64_t n, int64_t m, double *a, double *v) {
    double squared_norm = 0.0;
    for (int64_t i = 0; i < n * m; i++) squared_norm += a[i] * a[i];
    for (int sweep = 0, rotated = 1; sweep < MAX_SWEEPS && rotated; sweep++) {
        rotated = 0;
        for (int64_t p = 0; p + 1 < n; p++) {
            for (int64_t q = p + 1; q < n; q++) {
                double pp = 0.0, qq = 0.0, pq = 0.0;
                for (int64_t j = 0; j < m; j++) {
                    pp += a[p * m + j] * a[p * m + j];
                    qq += a[q * m + j] * a[q * m + j];
                    pq += a[p * m + j] * a[q * m + j];
                }
                /* Rows that are zero within rounding have no direction to rotate. */
                if (fabs(pq) <= 1e-15 * sqrt(pp * qq) || pp <= 1e-32 * squared_norm ||
                    qq <= 1e-32 * squared_norm)
                    continue;
                double cotangent = (qq - pp) / (2.0 * pq);
                double t = (cotangent >= 0.0 ? 1.0 : -1.0) / (fabs(cotangent) + sqrt(1.0 + cotangent * cotangent));
                double c = 1.0 / sqrt(1.0 + t * t), s = c * t;
                rotated = 1;
                for (int64_t j = 0; j < m; j++) {
                    double row_p = a[p * m + j], row_q = a[q * m + j];
                    a[p * m + j] = c * row_p - s * row_q, a[q * m + j] = s * row_p + c * row_q;
                }
                for (int64_t j = 0; j < n; j++) {
                    double row_p = v[p * n + j], row_q = v[q * n + j];
                    v[p * n + j] = c * row_p - s * row_q, v[q * n + j] = s * row_p + c * row_q;
                }
            }
        }
    }
}

/* Orthogonalise the rows of `count` matrices a (n, m) in place; v (n, n) starts as identity matrices. */
void dualarm_orthogonalise(int64_t count, int64_t n, int64_t m, double *a, double *v) {
    for (int64_t s = 0; s < count; s++) orthogonalise(n, m, a + s * n * m, v + s * n * n);
}

/* Find all roots of a polynomial t^n + c[n-1] t^(n-1) + ... + c[0] simultaneously (Aberth 1973). */
static void find_roots(int64_t n, const double *c, double *re, double *im) {
    double max_coefficient = 0.0;
    for (int64_t k = 0; k < n; k++) max_coefficient = fmax(max_coefficient, fabs(c[k]));
    double radius = fmin(1.0 + max_coefficient, 2.0 * pow(fmax(max_coefficient, 1e-300), 1.0 / (double)n));
    for (int64_t i = 0; i < n; i++) {
        double angle = 6.283185307179586 * ((double)i + 0.25) / (double)n;
        re[i] = radius * cos(angle), im[i] = radius * sin(angle);
    }
    for (int round = 0, moved = 1; round < MAX_ROUNDS && moved; round++) {
        moved = 0;
        for (int64_t i = 0; i < n; i++) {
            double x = re[i], y = im[i], fr = 1.0, fi = 0.0, dr = 0.0, di = 0.0, sr = 0.0, si = 0.0;
            for (int64_t k = n - 1; k >= 0; k--) {
                double slope = dr * x - di * y + fr;
                di = dr * y + di * x + fi, dr = slope;
                double value = fr * x - fi * y + c[k];
                fi = fr * y + fi * x, fr = value;
            }
            for (int64_t k = 0; k < n; k++) {
                double ax = x - re[k], ay = y - im[k], squared_distance = ax * ax + ay * ay;
                if (k != i && squared_distance > 0.0) sr += ax / squared_distance, si -= ay / squared_distance;
            }
            /* The step is f / (f' - f sum), with the sum of the reciprocal distances to the other roots. */
            double br = dr - (fr * sr - fi * si), bi = di - (fr * si + fi * sr), denominator = br * br + bi * bi;
            if (denominator == 0.0) continue;
            double step_r = (fr * br + fi * bi) / denominator, step_i = (fi * br - fr * bi) / denominator;
            re[i] = x - step_r, im[i] = y - step_i;
            if (fabs(step_r) + fabs(step_i) > 4e-16 * (fabs(x) + fabs(y))) moved = 1;
        }
    }
}

/* Find the roots of `count` monic polynomials of degree n from their lower coefficients, lowest first. */
void dualarm_zeros(int64_t count, int64_t n, const double *coefficients, double *re, double *im) {
    for (int64_t s = 0; s < count; s++) find_roots(n, coefficients + s * n, re + s * n, im + s * n);
}

/* Solve a banded system in place without pivoting: row r of `a` holds columns r - low to r + high. */
void dualarm_solve_banded(int64_t n, int64_t low, int64_t high, int64_t m, double *a, double *x) {
    const int64_t width = low + high + 1;
    for (int64_t c = 0; c < n; c++) {
        const double *pivot = a + c * width + low;
        const int64_t right = high < n - 1 - c ? high : n - 1 - c;
        for (int64_t r = c + 1; r < n && r <= c + low; r++) {
            double *row = a + r * width + low - (r - c);
            double factor = row[0] / pivot[0];
            for (int64_t j = 1; j <= right; j++) row[j] -= factor * pivot[j];
            for (int64_t j = 0; j < m; j++) x[r * m + j] -= factor * x[c * m + j];
        }
    }
    for (int64_t c = n - 1; c >= 0; c--) {
        const double *pivot = a + c * width + low;
        const int64_t right = high < n - 1 - c ? high : n - 1 - c;
        for (int64_t j = 0; j < m; j++) {
            for (int64_t k = 1; k <= right; k++) x[c * m + j] -= pivot[k] * x[(c + k) * m + j];
            x[c * m + j] /= pivot[0];
        }
    }
}
