// Arrays as Python has them, with any strides.
#pragma once

#include <cstddef>

#include "vec3.hpp"

namespace ffsms {

// Numbers (component, joint, motion, instant); along an axis that an array does not have the stride is zero.
struct Strided {
  const double* data = nullptr;
  std::ptrdiff_t component = 0, joint = 0, motion = 0, instant = 0;

  explicit operator bool() const { return data != nullptr; }

  // Of one motion at one instant.
  Strided at(std::ptrdiff_t s, std::ptrdiff_t k) const {
    return {data + s * motion + k * instant, component, joint, 0, 0};
  }

  double operator()(int c, int j = 0) const { return data[c * component + j * joint]; }
};

inline Vec3<double> vector(const Strided& of) { return {{of(0), of(1), of(2)}}; }

inline Mat3<double> matrix(const Strided& of) {
  Mat3<double> out;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) out[i][j] = of(i, j);
  }
  return out;
}

}  // namespace ffsms
