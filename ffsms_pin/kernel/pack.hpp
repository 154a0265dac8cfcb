// The numbers of the kernel: a double, or a pack of doubles with one lane for each of several configurations.
//
// The same formulas are used for both, and the results in every lane have the same bits as with a double. A
// pack consists of groups for the processor's vector instructions. A group has two lanes, four with AVX2, or
// one if the compiler has no vector types.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

namespace ffsms {

#if defined(__GNUC__)
#if defined(__AVX2__)
#define FFSMS_GROUP __attribute__((vector_size(32)))
#else
#define FFSMS_GROUP __attribute__((vector_size(16)))
#endif
using Group = double FFSMS_GROUP;
using GroupMask = std::int64_t FFSMS_GROUP;
#define FFSMS_INLINE inline __attribute__((always_inline))
FFSMS_INLINE bool any(const GroupMask& which) {
  std::int64_t some = 0;
  for (unsigned i = 0; i < sizeof which / sizeof some; ++i) some |= which[i];
  return some != 0;
}
#else
using Group = double;
using GroupMask = bool;
#define FFSMS_INLINE inline
#endif

using Index = std::int64_t;

constexpr int kLanes = 8;
constexpr int kGroups = kLanes * static_cast<int>(sizeof(double)) / static_cast<int>(sizeof(Group));

struct Pack {
  Group p[kGroups];

  Pack() = default;
  FFSMS_INLINE Pack(double x) {
    for (Group& group : p) group = Group{} + x;
  }
};
struct Mask {
  GroupMask p[kGroups];
};

#define FFSMS_OPERATOR(op, Result)                                 \
  FFSMS_INLINE Result operator op(const Pack& a, const Pack& b) {  \
    Result out;                                                    \
    for (int i = 0; i < kGroups; ++i) out.p[i] = a.p[i] op b.p[i]; \
    return out;                                                    \
  }
FFSMS_OPERATOR(+, Pack)
FFSMS_OPERATOR(-, Pack)
FFSMS_OPERATOR(*, Pack)
FFSMS_OPERATOR(/, Pack)
FFSMS_OPERATOR(<, Mask)
FFSMS_OPERATOR(>, Mask)
#undef FFSMS_OPERATOR

FFSMS_INLINE Pack operator-(const Pack& a) {
  Pack out;
  for (int i = 0; i < kGroups; ++i) out.p[i] = -a.p[i];
  return out;
}
FFSMS_INLINE Pack& operator+=(Pack& a, const Pack& b) { return a = a + b; }
FFSMS_INLINE Pack& operator-=(Pack& a, const Pack& b) { return a = a - b; }

// -- functions of a double or of each lane of a pack
FFSMS_INLINE double select(bool which, double yes, double no) { return which ? yes : no; }
FFSMS_INLINE Pack select(const Mask& which, const Pack& yes, const Pack& no) {
  Pack out;
  for (int i = 0; i < kGroups; ++i) out.p[i] = which.p[i] ? yes.p[i] : no.p[i];
  return out;
}

FFSMS_INLINE bool any(bool which) { return which; }
FFSMS_INLINE bool any(const Mask& which) {
  GroupMask all = which.p[0];
  for (int i = 1; i < kGroups; ++i) all = all | which.p[i];
  return any(all);
}

template <class Function>
FFSMS_INLINE double each(const Function& function, double x) {
  return function(x);
}
template <class Function>
FFSMS_INLINE Pack each(const Function& function, Pack x) {
  double lanes[kLanes];
  std::memcpy(lanes, &x, sizeof x);
  for (double& lane : lanes) lane = function(lane);
  std::memcpy(&x, lanes, sizeof x);
  return x;
}

template <class T>
FFSMS_INLINE T root(const T& x) {
  return each([](double lane) { return std::sqrt(lane); }, x);
}
template <class T>
FFSMS_INLINE T logarithm(const T& x) {
  return each([](double lane) { return std::log(lane); }, x);
}
template <class T>
FFSMS_INLINE T larger(const T& a, const T& b) {
  return select(a > b, a, b);
}
template <class T>
FFSMS_INLINE T magnitude(const T& x) {
  return select(x < 0.0, -x, x);
}

// -- sine and cosine together, with the same bits in every lane and on every machine

// Beyond this angle [rad] the system's sine and cosine are used, because the reduction to an eighth of a turn
// is not accurate.
constexpr double kFar = 1e6;

// Rounds to the nearest integer by adding and subtracting a number whose unit in the last place is 1.
template <class T>
FFSMS_INLINE T rounded(const T& x) {
  constexpr double kWhole = 6755399441055744.0;  // 1.5 * 2^52
  return (x + kWhole) - kWhole;
}

// Computes sine and cosine with an error below 3 ulp, by the polynomials of fdlibm (Sun Microsystems, 1993).
template <class T>
FFSMS_INLINE void sine_cosine(const T& x, T& sine, T& cosine) {
  const T quarters = rounded(x * 6.36619772367581382433e-01);
  const T r = ((x - quarters * 1.57079632673412561417e+00) - quarters * 6.07710050630396597660e-11) -
              quarters * 2.02226624879595063154e-21;
  const T z = r * r;
  const T odd = -1.66666666666666324348e-01 +
                z * (8.33333333332248946124e-03 +
                     z * (-1.98412698298579493134e-04 +
                          z * (2.75573137070700676789e-06 +
                               z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10))));
  const T even = 4.16666666666666019037e-02 +
                 z * (-1.38888888888741095749e-03 +
                      z * (2.48015872894767294178e-05 +
                           z * (-2.75573143513906633035e-07 +
                                z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))));
  const T near_sine = r + r * (z * odd);
  const T half = 0.5 * z, rest = 1.0 - half;
  const T near_cosine = rest + (((1.0 - rest) - half) + z * (z * even));
  // The number of quarter turns, -2 to 2, decides whether sine and cosine are swapped, and their signs.
  const T turn = quarters - 4.0 * rounded(0.25 * quarters);
  const auto swapped = magnitude(magnitude(turn) - 1.0) < 0.5;
  const T plus = 1.0, minus = -1.0;
  const T sine_sign = select(turn < -0.5, minus, select(turn > 1.5, minus, plus));
  const T cosine_sign = select(turn > 0.5, minus, select(turn < -1.5, minus, plus));
  sine = sine_sign * select(swapped, near_cosine, near_sine);
  cosine = cosine_sign * select(swapped, near_sine, near_cosine);
  const auto far = magnitude(x) > kFar;
  if (!any(far)) return;
  sine = select(far, each([](double lane) { return std::sin(lane); }, x), sine);
  cosine = select(far, each([](double lane) { return std::cos(lane); }, x), cosine);
}

// -- rows of doubles, each row `count` doubles after the last, at one configuration or those of a pack

// Reads values that consist of components T, such as Vec3. The rows have all first components, then all
// second components, and so on.
template <class T>
struct Reader {
  const double* row;
  std::size_t count;

  template <class Value>
  void next(Value* values, int n = 1) {
    for (std::size_t c = 0; c < sizeof(Value) / sizeof(T); ++c) {
      for (int j = 0; j < n; ++j, row += count)
        std::memcpy(reinterpret_cast<T*>(values + j) + c, row, sizeof(T));
    }
  }
};

// Writes values in the same order.
template <class T>
struct Writer {
  double* row;
  std::size_t count;

  template <class Value>
  void put(const Value* values, int n = 1) {
    for (std::size_t c = 0; c < sizeof(Value) / sizeof(T); ++c) {
      for (int j = 0; j < n; ++j, row += count)
        std::memcpy(row, reinterpret_cast<const T*>(values + j) + c, sizeof(T));
    }
  }
};

}  // namespace ffsms
