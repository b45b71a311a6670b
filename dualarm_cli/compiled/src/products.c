/* Products of stacks of matrices. Each number is a sum in the order of its index, whatever the processor. */

#include <stdint.h>

enum { BLOCK = 8, PACKED = 4096 };

typedef struct {
    const double *at;
    int64_t stack, row, column; /* distances of neighbours, in numbers */
} Matrices;

/* One product (n, k) (k, m) into rows of m numbers; the second factor's columns are neighbours. */
static void multiply(int64_t n, int64_t k, int64_t m, Matrices a, const double *b, int64_t row, double *out) {
    for (int64_t i = 0; i < n; i++, out += m) {
        const double *factor = a.at + i * a.row;
        int64_t j = 0;
        for (; j + BLOCK <= m; j += BLOCK) {
            double sum[BLOCK] = {0.0};
            for (int64_t l = 0; l < k; l++) {
                const double *other = b + l * row + j;
                for (int c = 0; c < BLOCK; c++) sum[c] += factor[l * a.column] * other[c];
            }
            for (int c = 0; c < BLOCK; c++) out[j + c] = sum[c];
        }
        for (; j < m; j++) {
            double sum = 0.0;
            for (int64_t l = 0; l < k; l++) sum += factor[l * a.column] * b[l * row + j];
            out[j] = sum;
        }
    }
}

/* One product whose second factor lies in memory in any way. */
static void multiply_spread(int64_t n, int64_t k, int64_t m, Matrices a, Matrices b, double *out) {
    for (int64_t i = 0; i < n; i++) {
        for (int64_t j = 0; j < m; j++) {
            double sum = 0.0;
            for (int64_t l = 0; l < k; l++)
                sum += a.at[i * a.row + l * a.column] * b.at[l * b.row + j * b.column];
            out[i * m + j] = sum;
        }
    }
}

/* Products of `count` pairs of matrices (n, k) and (k, m). Strides are bytes, as numpy has them. */
void dualarm_products(int64_t count, int64_t n, int64_t k, int64_t m, const double *a, int64_t a_stack, int64_t a_row,
                      int64_t a_column, const double *b, int64_t b_stack, int64_t b_row, int64_t b_column, double *out) {
    Matrices one = {a, a_stack / 8, a_row / 8, a_column / 8};
    Matrices other = {b, b_stack / 8, b_row / 8, b_column / 8};
    double packed[PACKED];
    int again = 1;
    for (int64_t s = 0; s < count; s++, one.at += one.stack, other.at += other.stack, out += n * m) {
        if (other.column == 1) {
            multiply(n, k, m, one, other.at, other.row, out);
        } else if (k * m <= PACKED && n > 1) {
            if (again || other.stack) {
                for (int64_t l = 0; l < k; l++)
                    for (int64_t j = 0; j < m; j++) packed[l * m + j] = other.at[l * other.row + j * other.column];
                again = 0;
            }
            multiply(n, k, m, one, packed, m, out);
        } else {
            multiply_spread(n, k, m, one, other, out);
        }
    }
}
