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
static_assert(sizeof(Pack) == kLanes * sizeof(double), "a pack is what lies in memory");

// Reads the rows of an array one after the other, at one configuration or at those of a pack.
struct Reader {
  const double* row;
  Size count;

  Reader(const In& array, Size k) : row(array.data() + k), count(array.shape(1)) {}
  template <class T>
  void next(T* values, int n) {
    for (int j = 0; j < n; ++j, row += count) std::memcpy(&values[j], row, sizeof(T));
  }
};

// Writes them.
struct Writer {
  double* row;
  Size count;

  Writer(const Out& array, Size k) : row(array.data() + k), count(array.shape(1)) {}
  template <class T>
  void put(const T* values, int n) {
    for (int j = 0; j < n; ++j, row += count) std::memcpy(row, &values[j], sizeof(T));
  }
  template <class T>
  void put(const Vec3<T>* columns, int n) {
    for (int x = 0; x < 3; ++x) {
      for (int j = 0; j < n; ++j) put(&columns[j][x], 1);
    }
  }
  template <class T>
  void put(const Mat3<T>* matrices, int n) {
    for (int x = 0; x < 3; ++x) {
      for (int y = 0; y < 3; ++y) {
        for (int j = 0; j < n; ++j) put(&matrices[j][x][y], 1);
      }
    }
  }
};

// Calls use(work, k) with work for packs of a stack, then, where fewer are left, for one configuration at a
// time.
template <template <class> class Work, class Use>
void along(Size count, const Use& use) {
  Size k = 0;
  if (count >= kLanes) {
    Work<Pack> work;
    for (; k + kLanes <= count; k += kLanes) use(work, k);
  }
  Work<double> work;
  for (; k < count; ++k) use(work, k);
}

inline void expect(bool holds, const char* what) {
  if (!holds) throw std::invalid_argument(what);
}

template <class Array>
void expect_rows(const Array& array, int rows, Size count) {
  expect(array.shape(0) == static_cast<Size>(rows) && array.shape(1) == count, "an array has a wrong shape");
}

}  // namespace ffsms
