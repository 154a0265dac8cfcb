// Numbers that the kernel computes with: one double, or a pack of them, one for each of several
// configurations.
//
// A pack is a vector type of the compiler, so the same formulas serve both, and every lane has the bits that
// a double has. Two lanes are what every processor of a kind has without special instructions.
#pragma once

#include <cmath>

namespace ffsms {

#if defined(__GNUC__)
constexpr int kLanes = 2;
using Pack = double __attribute__((vector_size(8 * kLanes)));
#else
constexpr int kLanes = 1;
using Pack = double;
#endif

inline double each(double (*function)(double), double x) { return function(x); }
inline double select(bool which, double yes, double no) { return which ? yes : no; }
inline bool any(bool which) { return which; }

#if defined(__GNUC__)
using PackMask = decltype(Pack{} < Pack{});

inline Pack each(double (*function)(double), Pack x) {
  for (int i = 0; i < kLanes; ++i) x[i] = function(x[i]);
  return x;
}
inline Pack select(PackMask which, Pack yes, Pack no) { return which ? yes : no; }
inline bool any(PackMask which) {
  for (int i = 0; i < kLanes; ++i) {
    if (which[i]) return true;
  }
  return false;
}
#endif

// A constant as a value of every lane.
template <class T>
T same(double x) {
  return T{} + x;
}
template <class T>
T sine(T x) {
  return each(std::sin, x);
}
template <class T>
T cosine(T x) {
  return each(std::cos, x);
}
template <class T>
T logarithm(T x) {
  return each(std::log, x);
}
template <class T>
T root(T x) {
  return each(std::sqrt, x);
}
template <class T>
T larger(T a, T b) {
  return select(a > b, a, b);
}
template <class T>
T smaller(T a, T b) {
  return select(a < b, a, b);
}
template <class T>
T magnitude(T x) {
  return select(x < 0.0, -x, x);
}

}  // namespace ffsms
