// Arrays that cross the border between Python and the headers: of doubles, components first, the stack last.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstring>
#include <initializer_list>
#include <stdexcept>

#include "vec3.hpp"

namespace ffsms {

namespace nb = nanobind;

using Size = std::size_t;
using In = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;  // dense, of any shape
template <class T, int... shape>                                      // -1: of any size
using Table = nb::ndarray<const T, nb::shape<shape...>, nb::c_contig, nb::device::cpu>;
using Vector = Table<double, -1>;
using Matrix = Table<double, -1, -1>;
using Rotation = Table<double, 3, 3>;
using Index = std::int64_t;
using Indices = Table<Index, -1>;
using Out = nb::ndarray<nb::numpy, double, nb::c_contig>;
static_assert(sizeof(Pack) == kLanes * sizeof(double), "a pack is what lies in memory");

inline void expect(bool holds, const char* what) {
  if (!holds) throw std::invalid_argument(what);
}

template <class Array>
void expect_size(const Array& array, Size size) {
  expect(array.size() == size, "an array has a wrong shape");
}

// A new array, which Python owns once it is returned; not filled.
template <typename... Sizes>
Out new_array(Sizes... sizes) {
  const Size shape[] = {static_cast<Size>(sizes)...};
  Size count = 1;
  for (const Size size : shape) count *= size;
  double* data = new double[count];
  const nb::capsule owner(data, [](void* memory) noexcept { delete[] static_cast<double*>(memory); });
  return Out(data, sizeof...(sizes), shape, owner);
}

// Reads the rows of `count` numbers one after the other, at one configuration or at those of a pack.
struct Reader {
  const double* row;
  Size count;

  template <class T>
  void next(T* values, int n) {
    for (int j = 0; j < n; ++j, row += count) std::memcpy(&values[j], row, sizeof(T));
  }
};

// Writes them.
struct Writer {
  double* row;
  Size count;

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

// What is bound, a file each.
void bind_stacks(nb::module_& m);
void bind_clearance(nb::module_& m);
void bind_motions(nb::module_& m);
void bind_step(nb::module_& m);

}  // namespace ffsms
