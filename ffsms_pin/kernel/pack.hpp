// Numbers that the kernel computes with: one double, or a pack of them, one for each of several
// configurations.
//
// The same formulas serve both, and every lane has the bits that a double has. A pack is made of pairs, which
// every processor of a kind computes with at once, without special instructions.
#pragma once

#include <cmath>
#include <cstdint>

namespace ffsms {

#if defined(__GNUC__)
constexpr int kPair = 2;
using Pair = double __attribute__((vector_size(16)));
using PairMask = std::int64_t __attribute__((vector_size(16)));
#define FFSMS_INLINE inline __attribute__((always_inline))
#else
constexpr int kPair = 1;
using Pair = double;
using PairMask = bool;
#define FFSMS_INLINE inline
#endif

constexpr int kPairs = 4;
constexpr int kLanes = kPair * kPairs;

struct Pack {
  Pair p[kPairs];
};
struct Mask {
  PairMask p[kPairs];
};

FFSMS_INLINE Pack filled(double x) {
  Pack out;
  for (int i = 0; i < kPairs; ++i) out.p[i] = Pair{} + x;
  return out;
}

#define FFSMS_OPERATOR(op)                                        \
  FFSMS_INLINE Pack operator op(const Pack& a, const Pack& b) {   \
    Pack out;                                                     \
    for (int i = 0; i < kPairs; ++i) out.p[i] = a.p[i] op b.p[i]; \
    return out;                                                   \
  }                                                               \
  FFSMS_INLINE Pack operator op(double a, const Pack& b) {        \
    Pack out;                                                     \
    for (int i = 0; i < kPairs; ++i) out.p[i] = a op b.p[i];      \
    return out;                                                   \
  }                                                               \
  FFSMS_INLINE Pack operator op(const Pack& a, double b) {        \
    Pack out;                                                     \
    for (int i = 0; i < kPairs; ++i) out.p[i] = a.p[i] op b;      \
    return out;                                                   \
  }                                                               \
  FFSMS_INLINE Pack& operator op## = (Pack & a, const Pack& b) {  \
    for (int i = 0; i < kPairs; ++i) a.p[i] = a.p[i] op b.p[i];   \
    return a;                                                     \
  }
FFSMS_OPERATOR(+)
FFSMS_OPERATOR(-)
FFSMS_OPERATOR(*)
FFSMS_OPERATOR(/)
#undef FFSMS_OPERATOR

FFSMS_INLINE Pack operator-(const Pack& a) {
  Pack out;
  for (int i = 0; i < kPairs; ++i) out.p[i] = -a.p[i];
  return out;
}

#define FFSMS_COMPARISON(op)                                      \
  FFSMS_INLINE Mask operator op(const Pack& a, const Pack& b) {   \
    Mask out;                                                     \
    for (int i = 0; i < kPairs; ++i) out.p[i] = a.p[i] op b.p[i]; \
    return out;                                                   \
  }                                                               \
  FFSMS_INLINE Mask operator op(const Pack& a, double b) { return a op filled(b); }
FFSMS_COMPARISON(<)
FFSMS_COMPARISON(>)
#undef FFSMS_COMPARISON

// -- what differs between a double and a pack, by one name
FFSMS_INLINE double select(bool which, double yes, double no) { return which ? yes : no; }
FFSMS_INLINE Pack select(const Mask& which, const Pack& yes, const Pack& no) {
  Pack out;
  for (int i = 0; i < kPairs; ++i) out.p[i] = which.p[i] ? yes.p[i] : no.p[i];
  return out;
}

FFSMS_INLINE bool both(bool a, bool b) { return a && b; }
FFSMS_INLINE Mask both(const Mask& a, const Mask& b) {
  Mask out;
  for (int i = 0; i < kPairs; ++i) out.p[i] = a.p[i] & b.p[i];
  return out;
}

FFSMS_INLINE bool any(bool which) { return which; }
FFSMS_INLINE bool any(const Mask& which) {
  PairMask all = which.p[0];
  for (int i = 1; i < kPairs; ++i) all = all | which.p[i];
#if defined(__GNUC__)
  return (all[0] | all[1]) != 0;
#else
  return all;
#endif
}

FFSMS_INLINE double each(double (*function)(double), double x) { return function(x); }
FFSMS_INLINE Pack each(double (*function)(double), const Pack& x) {
  Pack out;
  for (int i = 0; i < kPairs; ++i) {
#if defined(__GNUC__)
    out.p[i] = Pair{function(x.p[i][0]), function(x.p[i][1])};
#else
    out.p[i] = function(x.p[i]);
#endif
  }
  return out;
}

FFSMS_INLINE double root(double x) { return std::sqrt(x); }
FFSMS_INLINE Pack root(const Pack& x) {
  Pack out;
  for (int i = 0; i < kPairs; ++i) {
#if defined(__GNUC__)
    out.p[i] = Pair{std::sqrt(x.p[i][0]), std::sqrt(x.p[i][1])};
#else
    out.p[i] = std::sqrt(x.p[i]);
#endif
  }
  return out;
}

// A constant as a value of every lane.
template <class T>
T same(double x);
template <>
FFSMS_INLINE double same<double>(double x) {
  return x;
}
template <>
FFSMS_INLINE Pack same<Pack>(double x) {
  return filled(x);
}

template <class T>
FFSMS_INLINE T logarithm(const T& x) {
  return each(std::log, x);
}
template <class T>
FFSMS_INLINE T larger(const T& a, const T& b) {
  return select(a > b, a, b);
}
template <class T>
FFSMS_INLINE T smaller(const T& a, const T& b) {
  return select(a < b, a, b);
}
template <class T>
FFSMS_INLINE T magnitude(const T& x) {
  return select(x < 0.0, -x, x);
}

}  // namespace ffsms
