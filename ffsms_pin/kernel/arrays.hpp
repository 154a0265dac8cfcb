// Arrays of Python as the bindings see them: components first, the stack of configurations last.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstring>
#include <stdexcept>

#include "vec3.hpp"

namespace ffsms {

using In = nanobind::ndarray<const double, nanobind::ndim<2>, nanobind::c_contig, nanobind::device::cpu>;
using Out = nanobind::ndarray<double, nanobind::ndim<2>, nanobind::c_contig, nanobind::device::cpu>;
using Size = std::size_t;

// Configurations of a stack, one a lane; at its end, where fewer are left, the last one fills the lanes.
inline Pack load(const double* from, Size left) {
  Pack x;
  if (left >= kLanes) {
    std::memcpy(&x, from, sizeof x);
    return x;
  }
  double each[kLanes];
  for (Size i = 0; i < kLanes; ++i) each[i] = from[i < left ? i : left - 1];
  std::memcpy(&x, each, sizeof x);
  return x;
}

inline void store(Pack x, double* to, Size left) {
  std::memcpy(to, &x, sizeof(double) * (left < kLanes ? left : kLanes));
}

// Reads the rows of an array one after the other, at the configurations of a pack.
struct Reader {
  const double* row;
  Size count, left;

  Reader(const In& array, Size k) : row(array.data() + k), count(array.shape(1)), left(count - k) {}
  Pack next() {
    const Pack x = load(row, left);
    row += count;
    return x;
  }
};

// Writes them.
struct Writer {
  double* row;
  Size count, left;

  Writer(const Out& array, Size k) : row(array.data() + k), count(array.shape(1)), left(count - k) {}
  void put(Pack x) {
    store(x, row, left);
    row += count;
  }
  void put(const Vec3<Pack>* columns, int n) {
    for (int x = 0; x < 3; ++x) {
      for (int j = 0; j < n; ++j) put(columns[j][x]);
    }
  }
  void put(const Mat3<Pack>* matrices, int n) {
    for (int x = 0; x < 3; ++x) {
      for (int y = 0; y < 3; ++y) {
        for (int j = 0; j < n; ++j) put(matrices[j][x][y]);
      }
    }
  }
};

inline void expect(bool holds, const char* what) {
  if (!holds) throw std::invalid_argument(what);
}

template <class Array>
void expect_rows(const Array& array, int rows, Size count) {
  expect(array.shape(0) == static_cast<Size>(rows) && array.shape(1) == count, "an array has a wrong shape");
}

}  // namespace ffsms
