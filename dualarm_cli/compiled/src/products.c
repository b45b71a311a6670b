/* Products of stacks of matrices, summed in the order of the index on every processor. */

#include <stdint.h>
#include "status_flags.h"

enum { BLOCK = 8, PACKED = 4096 };

/* Stack of matrices. */
typedef struct {
    double *data;
    int64_t stack, row, column; /* strides in numbers */
} Matrices;

static Matrices matrices(char *data, int64_t stack, const int64_t *stride) {
    return (Matrices){(double *)data, stack / 8, stride[0] / 8, stride[1] / 8};
}

/* Multiply (n, k) by (k, m), with contiguous rows of the second factor. */
static void multiply(int64_t n, int64_t k, int64_t m, Matrices a, const double *b, int64_t b_stride, Matrices product) {
    for (int64_t i = 0; i < n; i++) {
        double *out = product.data + i * product.row;
        const double *factor = a.data + i * a.row;
        int64_t j = 0;
        for (; j + BLOCK <= m; j += BLOCK) {
            double sum[BLOCK] = {0.0};
            for (int64_t l = 0; l < k; l++) {
                const double *b_row = b + l * b_stride + j;
                for (int c = 0; c < BLOCK; c++) sum[c] += factor[l * a.column] * b_row[c];
            }
            for (int c = 0; c < BLOCK; c++) out[(j + c) * product.column] = sum[c];
        }
        for (; j < m; j++) {
            double sum = 0.0;
            for (int64_t l = 0; l < k; l++) sum += factor[l * a.column] * b[l * b_stride + j];
            out[j * product.column] = sum;
        }
    }
}

/* Multiply (n, k) by (k, m), with any strides. */
static void multiply_strided(int64_t n, int64_t k, int64_t m, Matrices a, Matrices b, Matrices product) {
    for (int64_t i = 0; i < n; i++) {
        for (int64_t j = 0; j < m; j++) {
            double sum = 0.0;
            for (int64_t l = 0; l < k; l++)
                sum += a.data[i * a.row + l * a.column] * b.data[l * b.row + j * b.column];
            product.data[i * product.row + j * product.column] = sum;
        }
    }
}

/* Inner loop of the numpy ufunc (n, k), (k, m) -> (n, m); restores the floating-point status flags. */
void dualarm_products(char **data, const int64_t *size, const int64_t *stride, void *unused) {
    (void)unused;
    int64_t count = size[0], n = size[1], k = size[2], m = size[3];
    Matrices a = matrices(data[0], stride[0], stride + 3), b = matrices(data[1], stride[1], stride + 5);
    Matrices product = matrices(data[2], stride[2], stride + 7);
    double packed[PACKED];
    int repack = 1;
    uint64_t flags = status_flags();
    for (int64_t s = 0; s < count; s++, a.data += a.stack, b.data += b.stack, product.data += product.stack) {
        if (b.column == 1) {
            multiply(n, k, m, a, b.data, b.row, product);
        } else if (k * m <= PACKED && n > 1 && m > 1) {
            if (repack || b.stack) {
                for (int64_t l = 0; l < k; l++)
                    for (int64_t j = 0; j < m; j++) packed[l * m + j] = b.data[l * b.row + j * b.column];
                repack = 0;
            }
            multiply(n, k, m, a, packed, m, product);
        } else {
            multiply_strided(n, k, m, a, b, product);
        }
    }
    restore_status_flags(flags);
}
