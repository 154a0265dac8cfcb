// Singular values of small matrices, to the last digits of the small ones too.
//
// Householder reflections make the matrix bidiagonal, then the differential qd algorithm finds the squares of
// the singular values. It only adds, multiplies and divides positive numbers, so small singular values keep
// their digits; the eigenvalues of C^T C lose them.
//
// References: K. V. Fernando, B. N. Parlett, "Accurate singular values and differential qd algorithms",
// Numerische Mathematik 67 (1994). The shift is Laguerre's bound: B. N. Parlett, "Laguerre's method applied
// to the matrix eigenvalue problem", Mathematics of Computation 18 (1964).
#pragma once

#include "tree.hpp"

namespace ffsms {

constexpr int kMostValues = 6;

// Squares are kept above this, the largest entry of a matrix being one: nothing is divided by zero.
constexpr double kLeastSquare = 1e-36;
// An off-diagonal square below this share of the diagonals beside it moves no digit of the square root.
constexpr double kNegligible = 1e-30;
// Of the bound that is a shift: short of it by more than rounding, so that every number stays positive.
constexpr double kShort = 1.0 - 1e-8;
// Of a sum of some twenty positive terms, with room.
constexpr double kRounding = 1e-13;
// For one singular value. Three to six are usual, since the shift converges with order three.
constexpr int kMostQdSweeps = 40;

// Reflects the vector x (k) onto its first axis, and with it the vectors whose entries lie beside its own:
// `count` of them, `apart` from one to the next. Entries are `step` apart. Returns |x|^2.
template <class T>
T reflect(T* x, int k, int step, int count, int apart) {
  T square = T{};
  for (int i = 0; i < k; ++i) square += x[i * step] * x[i * step];
  if (k < 2 || count < 1) return square;
  const T norm = root(square), first = x[0];
  const T half = square + norm * magnitude(first);  // v^T v / 2; where x is zero, so is v
  const T scale = 1.0 / select(half > 0.0, half, same<T>(1.0));
  x[0] = first + select(first < 0.0, -norm, norm);
  for (int j = 1; j <= count; ++j) {
    T along = T{};
    for (int i = 0; i < k; ++i) along += x[i * step] * x[i * step + j * apart];
    along = along * scale;
    for (int i = 0; i < k; ++i) x[i * step + j * apart] -= along * x[i * step];
  }
  return square;
}

// Squares of the diagonal and of the superdiagonal of a bidiagonal matrix with the singular values of A (m,
// n), m >= n, rows `kMostValues` apart; A is overwritten. Signs do not matter, so the squares are all there
// is to keep.
template <class T>
void bidiagonal(T* A, int m, int n, T* q, T* e) {
  constexpr int row = kMostValues;
  for (int j = 0; j < n; ++j) {
    T* corner = A + j * row + j;
    q[j] = reflect(corner, m - j, row, n - j - 1, 1);
    if (j + 1 < n) e[j] = reflect(corner + 1, n - j - 1, 1, m - j - 1, row);
  }
}

// A lower bound of the least of k squares, by the traces of the inverse and of its square.
template <class T>
T laguerre(const T* q, const T* e, int k) {
  T inverse = 1.0 / q[0], u = same<T>(1.0), w = T{};
  T first = inverse, second = inverse * inverse;
  for (int i = 0; i + 1 < k; ++i) {
    const T grow = e[i] * inverse;
    w = grow * (w + 2.0 * u * u * inverse);
    u = 1.0 + grow * u;
    inverse = 1.0 / q[i + 1];
    const T g = u * inverse;
    first += g;
    second += g * g + w * inverse;
  }
  // Where all squares are nearly equal the difference is rounding, and must not make the bound too large.
  const double d = k;
  const T spread = (d - 1.0) * larger(d * second - first * first, kRounding * second);
  return d / (first + root(spread));
}

// Sweeps of the differential qd algorithm with shifts (dqds) until the last of k rows stands alone in all
// lanes. A lane that is done stays as it is.
template <class T>
void loosen(T* q, T* e, int k, T& shift) {
  for (int sweep = 0; sweep < kMostQdSweeps; ++sweep) {
    const auto left = e[k - 2] > kNegligible * (q[k - 1] + shift) + 4.0 * kLeastSquare;
    if (!any(left)) return;
    const T least = same<T>(kLeastSquare), step = kShort * laguerre(q, e, k);
    T d = larger(q[0] - step, least);
    for (int i = 0; i + 1 < k; ++i) {
      const T whole = d + e[i], ratio = q[i + 1] / whole;
      q[i] = select(left, whole, q[i]);
      e[i] = select(left, larger(e[i] * ratio, least), e[i]);
      d = larger(d * ratio - step, least);
    }
    q[k - 1] = select(left, d, q[k - 1]);
    shift = select(left, shift + step, shift);
  }
}

// Singular values (n), the largest first, of A (m, n) with m >= n, which is overwritten. To 1e-14 of the
// largest, usually to 1e-15.
template <class T>
void singular_values(T (*A)[kMostValues], int m, int n, T* sigma) {
  T size = T{};
  for (int i = 0; i < m; ++i) {
    for (int j = 0; j < n; ++j) size = larger(size, magnitude(A[i][j]));
  }
  const T scale = select(size > 0.0, size, same<T>(1.0));
  for (int i = 0; i < m; ++i) {
    for (int j = 0; j < n; ++j) A[i][j] = A[i][j] / scale;
  }
  T q[kMostValues], e[kMostValues], shift = T{};
  bidiagonal(&A[0][0], m, n, q, e);
  const T least = same<T>(kLeastSquare);
  for (int i = 0; i < n; ++i) {
    q[i] = larger(q[i], least);
    if (i + 1 < n) e[i] = larger(e[i], least);
  }
  for (int k = n; k > 1; --k) {
    loosen(q, e, k, shift);
    // The last row has come loose: its diagonal is a square, less the shift.
    q[k - 1] += shift;
  }
  q[0] += shift;
  for (int i = 0; i < n; ++i) {
    sigma[i] = root(q[i]) * size;
    for (int j = i; j > 0; --j) {
      const T high = larger(sigma[j - 1], sigma[j]), low = smaller(sigma[j - 1], sigma[j]);
      sigma[j - 1] = high;
      sigma[j] = low;
    }
  }
}

}  // namespace ffsms
