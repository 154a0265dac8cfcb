// The Cholesky factorisation and triangular solves, for the quadratic programs (QPs) of Gauss-Newton steps.
#pragma once

#include <cmath>

namespace ffsms {

// Subtracts the sum over k < count of factor k times row k from the entries `begin` <= j < `end` of a row.
// Four rows are subtracted at a time, so each entry is loaded and stored a quarter as often.
inline void subtract_rows(double* row, const double* factors, const double* rows, int step, int width,
                          int count, int begin, int end) {
  int k = 0;
  for (; k + 4 <= count; k += 4, factors += 4 * step, rows += 4 * width) {
    const double a = factors[0], b = factors[step], c = factors[2 * step], d = factors[3 * step];
    const double *first = rows, *second = first + width, *third = second + width, *fourth = third + width;
    for (int j = begin; j < end; ++j) {
      row[j] -= a * first[j] + b * second[j] + (c * third[j] + d * fourth[j]);
    }
  }
  for (; k < count; ++k, factors += step, rows += width) {
    const double a = *factors;
    for (int j = begin; j < end; ++j) row[j] -= a * rows[j];
  }
}

// Replaces the upper triangle of a symmetric matrix A (n, n) by U with A = U^T U. Returns false if A is not
// positive definite.
inline bool cholesky(double* A, int n) {
  for (int i = 0; i < n; ++i) {
    double* row = A + i * n;
    subtract_rows(row, A + i, A, n, n, i, i, n);
    if (!(row[i] > 0.0)) return false;
    const double inverse = 1.0 / std::sqrt(row[i]);
    for (int j = i; j < n; ++j) row[j] *= inverse;
  }
  return true;
}

// Solves U^T X = B for B (n, count), in place.
inline void solve_lower(const double* U, double* B, int n, int count) {
  for (int i = 0; i < n; ++i) {
    double* row = B + i * count;
    subtract_rows(row, U + i, B, n, count, i, 0, count);
    const double inverse = 1.0 / U[i * n + i];
    for (int j = 0; j < count; ++j) row[j] *= inverse;
  }
}

// Solves U x = b for b (n), in place.
inline void solve_upper(const double* U, double* b, int n) {
  for (int i = n; i-- > 0;) {
    double left = b[i];
    for (int k = i + 1; k < n; ++k) left -= U[i * n + k] * b[k];
    b[i] = left / U[i * n + i];
  }
}

}  // namespace ffsms
