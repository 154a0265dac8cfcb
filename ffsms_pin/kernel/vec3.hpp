// Vectors (3) and matrices (3, 3); T is a double or a pack of doubles.
#pragma once

#include "pack.hpp"

namespace ffsms {

template <class T>
struct Vec3 {
  T v[3];

  T& operator[](int i) { return v[i]; }
  const T& operator[](int i) const { return v[i]; }
  // Converts constants to packs with the constant in every lane.
  template <class S>
  operator Vec3<S>() const {
    return {{S(v[0]), S(v[1]), S(v[2])}};
  }
};
template <class T>
using Mat3 = Vec3<Vec3<T>>;  // row, column

// Returns a struct that has only doubles, from an array of doubles.
template <class Value>
Value of_numbers(const double* x) {
  Value out;
  std::memcpy(&out, x, sizeof out);
  return out;
}

template <class T>
Vec3<T> operator+(const Vec3<T>& a, const Vec3<T>& b) {
  return {{a[0] + b[0], a[1] + b[1], a[2] + b[2]}};
}
template <class T>
Vec3<T> operator-(const Vec3<T>& a, const Vec3<T>& b) {
  return {{a[0] - b[0], a[1] - b[1], a[2] - b[2]}};
}
template <class T, class S>
Vec3<T> operator*(S s, const Vec3<T>& a) {
  return {{s * a[0], s * a[1], s * a[2]}};
}
template <class T>
Vec3<T> operator/(const Vec3<T>& a, const T& s) {
  return {{a[0] / s, a[1] / s, a[2] / s}};
}
template <class T>
void operator+=(Vec3<T>& a, const Vec3<T>& b) {
  for (int i = 0; i < 3; ++i) a[i] += b[i];
}

template <class T, class S>
T dot(const Vec3<T>& a, const Vec3<S>& b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
template <class T>
Vec3<T> cross(const Vec3<T>& a, const Vec3<T>& b) {
  return {{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]}};
}

template <class T, class S>
Vec3<T> operator*(const Mat3<T>& a, const Vec3<S>& b) {
  Vec3<T> out;
  for (int i = 0; i < 3; ++i) out[i] = a[i][0] * b[0] + a[i][1] * b[1] + a[i][2] * b[2];
  return out;
}
template <class T, class S>
Mat3<T> operator*(const Mat3<T>& a, const Mat3<S>& b) {
  Mat3<T> out;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) out[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
  }
  return out;
}
template <class T>
Mat3<T> transposed(const Mat3<T>& a) {
  return {{{{a[0][0], a[1][0], a[2][0]}}, {{a[0][1], a[1][1], a[2][1]}}, {{a[0][2], a[1][2], a[2][2]}}}};
}

// a b^T
template <class T>
Mat3<T> outer(const Vec3<T>& a, const Vec3<T>& b) {
  return {{a[0] * b, a[1] * b, a[2] * b}};
}

// The matrix [a]x of the cross product with a.
template <class T>
Mat3<T> skew(const Vec3<T>& a) {
  return {{{{T{}, -a[2], a[1]}}, {{a[2], T{}, -a[0]}}, {{-a[1], a[0], T{}}}}};
}

// Adds mass (d.d 1 - d d^T), the parallel-axis term of a mass at the distance vector d.
template <class T>
void add_steiner(Mat3<T>& inertia, T mass, const Vec3<T>& d) {
  const Vec3<T> scaled = mass * d;
  const T square = dot(scaled, d);
  for (int i = 0; i < 3; ++i) {
    inertia[i] = inertia[i] - scaled[i] * d;
    inertia[i][i] += square;
  }
}

// Returns the inverse of a symmetric positive definite matrix, by cofactors.
template <class T>
Mat3<T> inverse_symmetric(const Mat3<T>& a) {
  const T c00 = a[1][1] * a[2][2] - a[1][2] * a[2][1];
  const T c01 = a[1][2] * a[2][0] - a[1][0] * a[2][2];
  const T c02 = a[1][0] * a[2][1] - a[1][1] * a[2][0];
  const T factor = 1.0 / (a[0][0] * c00 + a[0][1] * c01 + a[0][2] * c02);
  const T c11 = a[0][0] * a[2][2] - a[0][2] * a[2][0];
  const T c12 = a[0][1] * a[2][0] - a[0][0] * a[2][1];
  const T c22 = a[0][0] * a[1][1] - a[0][1] * a[1][0];
  return {{{{c00 * factor, c01 * factor, c02 * factor}},
           {{c01 * factor, c11 * factor, c12 * factor}},
           {{c02 * factor, c12 * factor, c22 * factor}}}};
}

}  // namespace ffsms
