// Arrays that cross the border between Python and the headers: dense, row by row, of doubles.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

namespace ffsms {

namespace nb = nanobind;

using Vector = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Matrix = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Array = nb::ndarray<nb::numpy, double, nb::c_contig>;

// A new array, which Python owns once it is returned; not filled.
template <typename... Sizes>
Array new_array(Sizes... sizes) {
  const size_t shape[] = {static_cast<size_t>(sizes)...};
  size_t count = 1;
  for (const size_t size : shape) count *= size;
  double* data = new double[count];
  const nb::capsule owner(data, [](void* memory) noexcept { delete[] static_cast<double*>(memory); });
  return Array(data, sizeof...(sizes), shape, owner);
}

}  // namespace ffsms
