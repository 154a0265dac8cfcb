// Singular values of small matrices, and the paper's normalised entropy of them with its gradient.
//
// One-sided Jacobi rotations: pairs of columns are turned until all are across each other, so that a matrix
// U sigma V^T becomes U sigma. Small singular values keep their digits; the eigenvalues of C^T C lose them.
//
// Reference: J. Demmel, K. Veselic, "Jacobi's method is more accurate than QR", SIAM Journal on Matrix
// Analysis and Applications 13 (1992).
#pragma once

#include <algorithm>

#include "arm.hpp"

namespace ffsms {

constexpr int kMostRows = 6;  // of C_bm and of J*

// Columns count as across each other below this cosine, and where what they share is so little of the whole
// matrix; squares.
constexpr double kAcross = 1e-31, kNegligible = 1e-34;
// Beyond what any matrix has needed: six are usual.
constexpr int kMostSweeps = 30;

// Turns two columns (m) across each other, and with them two columns (n) of V. A lane in which they are
// stays as it is. False: nothing was left to do in any lane.
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

// The k columns (m) of A, one after the other, become U sigma; those of V (k, k), where it is given, the
// right singular vectors. The values come in no order.
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

// The largest first, and the columns of V with them.
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

// Singular values of C / scale (rows, n) times the scale, the largest first: n of them with the columns of
// V (n, n), where it is given; else the lesser of rows and n, which it returns.
template <class T>
int singular_values(int rows, int n, const T* C, T* V, T* sigma, const T& scale = 1.0) {
  const bool by_rows = V == nullptr && rows < n;  // the fewer vectors are turned
  const int k = by_rows ? rows : n, m = by_rows ? n : rows;
  T A[kMostRows * kMostJoints];
  for (int i = 0; i < k * m; ++i) A[i] = C[by_rows ? i : i % m * n + i / m] / scale;
  decompose(m, k, A, V, sigma);
  for (int i = 0; i < k; ++i) sigma[i] = scale * sigma[i];
  sort(k, sigma, V);
  return k;
}

// Singular values are kept above this: x log x is zero there to rounding, and its slope is finite.
constexpr double kLeastValue = 1e-12;
// And above this share of the largest: below it, directions of singular vectors are rounding.
constexpr double kLeastShare = 1e-8;

// H_norm of C (rows, n), and its gradient.
template <class T>
T entropy(int rows, int n, const T* C, T* gradient) {
  const bool by_rows = n > rows;  // the fewer vectors are turned
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
  // With A = U sigma V^T the gradient is U slope V^T, and U sigma is what A has become.
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
