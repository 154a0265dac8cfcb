// Eigenvalues and eigenvectors of small symmetric matrices by cyclic Jacobi rotations.
#pragma once

#include "pack.hpp"

namespace ffsms {

constexpr int kMostRows = 6;  // of C_bm, and so of the smaller of its two squares

template <class T>
using Square = T[kMostRows][kMostRows];

// Beyond what any matrix has needed: six are usual.
constexpr int kMostSweeps = 20;

// Rotates rows and columns p and q so that A[p][q] vanishes; where it is negligible, by nothing at all. So a
// lane that is done stays as it is while others go on. False: nothing was left to do in any lane.
template <class T>
bool rotate(int n, int p, int q, T negligible, Square<T>& A, Square<T>& V) {
  const T off = A[p][q], first = A[p][p], last = A[q][q];
  const auto left = both(off * off > 1e-33 * magnitude(first * last), magnitude(off) > negligible);
  if (!any(left)) {
    A[p][q] = A[q][p] = T{};
    return false;
  }
  const T slant = (last - first) / select(left, 2.0 * off, same<T>(1.0));
  const T sign = select(slant < 0.0, same<T>(-1.0), same<T>(1.0));
  const T tangent = select(left, sign / (magnitude(slant) + root(slant * slant + 1.0)), T{});
  const T cosine = 1.0 / root(tangent * tangent + 1.0), sine = tangent * cosine;
  for (int k = 0; k < n; ++k) {
    const T x = A[k][p], y = A[k][q];
    A[k][p] = A[p][k] = cosine * x - sine * y;
    A[k][q] = A[q][k] = sine * x + cosine * y;
    const T v = V[k][p], w = V[k][q];
    V[k][p] = cosine * v - sine * w;
    V[k][q] = sine * v + cosine * w;
  }
  A[p][p] = first - tangent * off;
  A[q][q] = last + tangent * off;
  A[p][q] = A[q][p] = T{};
  return true;
}

// A (n, n) becomes diagonal; the columns of V are its eigenvectors.
template <class T>
void jacobi(int n, Square<T>& A, Square<T>& V) {
  T trace = T{};
  for (int i = 0; i < n; ++i) {
    trace += A[i][i];
    for (int j = 0; j < n; ++j) V[i][j] = same<T>(i == j ? 1.0 : 0.0);
  }
  const T negligible = 1e-20 * trace;
  for (int sweep = 0; sweep < kMostSweeps; ++sweep) {
    bool more = false;
    for (int p = 0; p < n; ++p) {
      for (int q = p + 1; q < n; ++q) more |= rotate(n, p, q, negligible, A, V);
    }
    if (!more) return;
  }
}

}  // namespace ffsms
