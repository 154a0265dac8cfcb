// Sine and cosine together: the same bits for every lane, and on every machine, whatever its library of
// functions.
#pragma once

#include "pack.hpp"

namespace ffsms {

// Up to here the angle is reduced to an eighth of a turn without loss; beyond, the system's functions serve
// [rad].
constexpr double kFar = 1e6;

// To the nearest whole number: what is below the last digit falls off.
template <class T>
FFSMS_INLINE T rounded(const T& x) {
  constexpr double kWhole = 6755399441055744.0;  // 1.5 * 2^52
  return (x + kWhole) - kWhole;
}

// To an ulp or so. Reduction and polynomials are those of fdlibm (Sun Microsystems, 1993).
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
  // Quarters of a turn, -2 to 2, change names and signs.
  const T turn = quarters - 4.0 * rounded(0.25 * quarters);
  const auto swapped = magnitude(magnitude(turn) - 1.0) < 0.5;
  const T plus = same<T>(1.0), minus = same<T>(-1.0);
  const T sine_sign = select(turn < -0.5, minus, select(turn > 1.5, minus, plus));
  const T cosine_sign = select(turn > 0.5, minus, select(turn < -1.5, minus, plus));
  sine = sine_sign * select(swapped, near_cosine, near_sine);
  cosine = cosine_sign * select(swapped, near_sine, near_cosine);
  const auto far = magnitude(x) > kFar;
  if (!any(far)) return;
  sine = select(far, each(std::sin, x), sine);
  cosine = select(far, each(std::cos, x), cosine);
}

}  // namespace ffsms
