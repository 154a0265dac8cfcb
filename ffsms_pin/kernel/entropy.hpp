// Singular values of small matrices, and the paper's normalised entropy of singular values with its gradient.
//
// One-sided Jacobi rotations are applied to pairs of columns until all columns are orthogonal, so that a
// matrix U sigma V^T becomes U sigma. Small singular values keep their digits, unlike with eigenvalues of
// C^T C.
//
// Reference: J. Demmel, K. Veselic, "Jacobi's method is more accurate than QR", SIAM Journal on Matrix
// Analysis and Applications 13 (1992).
#pragma once

#include <algorithm>

#include "arm.hpp"

namespace ffsms {

constexpr int kMostRows = 6;  // of C_bm and of J*

// Two columns are taken as orthogonal if the square of their cosine is at most kAcross, or if the square of
// their dot product is at most kNegligible times the squared norms of the matrix and of the longer column.
constexpr double kAcross = 1e-31, kNegligible = 1e-34;
// Largest number of sweeps; about six are usual.
constexpr int kMostSweeps = 30;

// Makes two columns (m) orthogonal by a rotation, and applies it to two columns (n) of V. Lanes with
// orthogonal columns do not change. Returns false if the columns are orthogonal in all lanes.
template <class T>
bool rotate(int m, T* a, T* b, int n, T* v, T* w, T whole) {
  T first = T{}, last = T{}, off = T{};
  for (int i = 0; i < m; ++i) {
    first += a[i] * a[i];
    last += b[i] * b[i];
    off += a[i] * b[i];
  }
  const T least = larger(kAcross * (first * last), kNegligible * (whole * larger(first, last)));
  const auto left = off * off > least;
  if (!any(left)) return false;
  const T slant = (last - first) / select(left, 2.0 * off, T(1.0));
  const T sign = select(slant < 0.0, T(-1.0), T(1.0));
  const T tangent = select(left, sign / (magnitude(slant) + root(slant * slant + 1.0)), T{});
  const T cosine = 1.0 / root(tangent * tangent + 1.0), sine = tangent * cosine;
  const auto turn = [&](int count, T* x, T* y) {
    for (int i = 0; i < count; ++i) {
      const T before = x[i];
      x[i] = cosine * before - sine * y[i];
      y[i] = sine * before + cosine * y[i];
    }
  };
  turn(m, a, b);
  turn(n, v, w);
  return true;
}

// Replaces A, stored as k columns (m), by U sigma, and V (k, k), unless null, by the right singular vectors.
// The singular values are not sorted.
template <class T>
void decompose(int m, int k, T* A, T* V, T* sigma) {
  const int n = V == nullptr ? 0 : k;
  const auto square = [&](int j) {
    T sum = T{};
    for (int i = 0; i < m; ++i) sum += A[j * m + i] * A[j * m + i];
    return sum;
  };
  T whole = T{};
  for (int j = 0; j < k; ++j) {
    whole += square(j);
    for (int i = 0; i < n; ++i) V[j * n + i] = T(i == j ? 1.0 : 0.0);
  }
  for (int sweep = 0; sweep < kMostSweeps; ++sweep) {
    bool more = false;
    for (int p = 0; p < k; ++p) {
      for (int q = p + 1; q < k; ++q) more |= rotate(m, A + p * m, A + q * m, n, V + p * n, V + q * n, whole);
    }
    if (!more) break;
  }
  for (int j = 0; j < k; ++j) sigma[j] = root(square(j));
}

// Sorts the singular values, the largest first, and the columns of V with them.
template <class T>
void sort(int k, T* sigma, T* V) {
  const auto swap = [](auto before, T& x, T& y) {
    const T low = select(before, x, y);
    x = select(before, y, x);
    y = low;
  };
  for (int i = 1; i < k; ++i) {
    for (int j = i; j > 0; --j) {
      const auto before = sigma[j - 1] < sigma[j];
      if (!any(before)) break;
      swap(before, sigma[j - 1], sigma[j]);
      for (int x = 0; V != nullptr && x < k; ++x) swap(before, V[(j - 1) * k + x], V[j * k + x]);
    }
  }
}

// Computes the singular values of C (rows, n), the largest first, from C / scale. With V (n, n) there are n
// values and the right singular vectors, without V min(rows, n) values. Returns the number of values.
template <class T>
int singular_values(int rows, int n, const T* C, T* V, T* sigma, const T& scale = 1.0) {
  const bool by_rows = V == nullptr && rows < n;  // rotates rows if there are fewer rows than columns
  const int k = by_rows ? rows : n, m = by_rows ? n : rows;
  T A[kMostRows * kMostJoints];
  for (int i = 0; i < k * m; ++i) A[i] = C[by_rows ? i : i % m * n + i / m] / scale;
  decompose(m, k, A, V, sigma);
  for (int i = 0; i < k; ++i) sigma[i] = scale * sigma[i];
  sort(k, sigma, V);
  return k;
}

// Smaller singular values are replaced by this value, at which x log x has a finite slope.
constexpr double kLeastValue = 1e-12;
// Singular values below this share of the largest are replaced by the share, because the directions of their
// singular vectors are rounding errors.
constexpr double kLeastShare = 1e-8;

// Returns H_norm of C (rows, n), and computes its gradient (rows, n).
template <class T>
T entropy(int rows, int n, const T* C, T* gradient) {
  const bool by_rows = n > rows;  // rotates rows if there are fewer rows than columns
  const int k = by_rows ? rows : n, m = by_rows ? n : rows;
  const auto at = [&](int i, int j) { return by_rows ? i * n + j : j * n + i; };
  T A[kMostRows * kMostJoints], V[kMostRows * kMostRows], sigma[kMostRows], logs[kMostRows];
  for (int i = 0; i < k * m; ++i) A[i] = C[at(i / m, i % m)];
  decompose(m, k, A, V, sigma);
  T largest = T(kLeastValue), total = T{}, plain = T{};
  for (int i = 0; i < k; ++i) largest = larger(largest, sigma[i]);
  for (int i = 0; i < k; ++i) {
    sigma[i] = larger(larger(sigma[i], kLeastShare * largest), T(kLeastValue));
    total += sigma[i];
  }
  for (int i = 0; i < k; ++i) {
    const T share = sigma[i] / total;
    logs[i] = logarithm(share);
    plain += share * logs[i];
  }
  const double scale = 1.0 / std::log(static_cast<double>(n));
  // With A = U sigma V^T the gradient is U slope V^T, and A now contains U sigma.
  for (int i = 0; i < k; ++i) sigma[i] = scale * (plain - logs[i]) / (total * sigma[i]);
  for (int i = 0; i < k; ++i) {
    for (int j = 0; j < m; ++j) {
      T sum = T{};
      for (int e = 0; e < k; ++e) sum += A[e * m + j] * sigma[e] * V[e * k + i];
      gradient[at(i, j)] = sum;
    }
  }
  return -scale * plain;
}

}  // namespace ffsms
