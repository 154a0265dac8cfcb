// The paper's normalised entropy of singular values, and its gradient by the entries of the coupling.
#pragma once

#include "jacobi.hpp"
#include "tree.hpp"

namespace ffsms {

// Singular values are kept above this: x log x is zero there to rounding, and its slope is finite.
constexpr double kLeastValue = 1e-12;
// And above this share of the largest, where they come from their squares.
constexpr double kLeastShare = 1e-8;

// H_norm of C (rows, n), and its gradient. By the eigenvalues of C C^T or C^T C, whichever is smaller.
template <class T>
T entropy(int rows, int n, const T (&C)[kMostRows][kMostJoints], T (&gradient)[kMostRows][kMostJoints]) {
  // Rows that are zero, as those of a planar arm, are exactly so from the left only.
  const bool by_rows = n > rows || (n == rows && rows < 6);
  const int r = by_rows ? rows : n;
  Square<T> A, V, W;
  for (int i = 0; i < r; ++i) {
    for (int j = 0; j <= i; ++j) {
      T sum = T{};
      if (by_rows) {
        for (int k = 0; k < n; ++k) sum += C[i][k] * C[j][k];
      } else {
        for (int k = 0; k < rows; ++k) sum += C[k][i] * C[k][j];
      }
      A[i][j] = A[j][i] = sum;
    }
  }
  jacobi(r, A, V);
  T sigma[kMostRows], logs[kMostRows], largest = T{}, total = T{}, plain = T{};
  for (int i = 0; i < r; ++i) {
    sigma[i] = root(larger(A[i][i], same<T>(kLeastValue * kLeastValue)));
    largest = larger(largest, sigma[i]);
  }
  for (int i = 0; i < r; ++i) {
    sigma[i] = larger(sigma[i], kLeastShare * largest);
    total += sigma[i];
  }
  for (int i = 0; i < r; ++i) {
    const T share = sigma[i] / total;
    logs[i] = logarithm(share);
    plain += share * logs[i];
  }
  const double scale = 1.0 / std::log(static_cast<double>(n));
  // With C = U sigma V^T the gradient is U slope V^T = C V (slope / sigma) V^T, or from the left.
  T slope[kMostRows];
  for (int k = 0; k < r; ++k) slope[k] = scale * (plain - logs[k]) / (total * sigma[k]);
  for (int i = 0; i < r; ++i) {
    for (int j = 0; j <= i; ++j) {
      T sum = T{};
      for (int k = 0; k < r; ++k) sum += V[i][k] * slope[k] * V[j][k];
      W[i][j] = W[j][i] = sum;
    }
  }
  for (int i = 0; i < rows; ++i) {
    for (int j = 0; j < n; ++j) {
      T sum = T{};
      for (int k = 0; k < r; ++k) sum += by_rows ? W[i][k] * C[k][j] : C[i][k] * W[k][j];
      gradient[i][j] = sum;
    }
  }
  return -scale * plain;
}

}  // namespace ffsms
