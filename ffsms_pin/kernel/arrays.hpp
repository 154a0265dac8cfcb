// Conversions between Python's arrays and the types of the headers.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "arm.hpp"

namespace ffsms {

namespace nb = nanobind;

using Size = std::size_t;
using In = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;  // dense, of any shape
template <class T, int... shape>                                      // -1: of any size
using Table = nb::ndarray<const T, nb::shape<shape...>, nb::c_contig, nb::device::cpu>;
using Vector = Table<double, -1>;
using Matrix = Table<double, -1, -1>;
using Indices = Table<Index, -1>;
using Out = nb::ndarray<nb::numpy, double, nb::c_contig>;
static_assert(sizeof(Pack) == kLanes * sizeof(double), "a pack must be stored as contiguous doubles");

inline void expect(bool holds, const char* what) {
  if (!holds) throw std::invalid_argument(what);
}

template <class Array>
void expect_size(const Array& array, Size size) {
  expect(array.size() == size, "an array has a wrong shape");
}

// Returns a new uninitialised array whose memory Python frees.
template <typename... Sizes>
Out new_array(Sizes... sizes) {
  const Size shape[] = {static_cast<Size>(sizes)...};
  Size count = 1;
  for (const Size size : shape) count *= size;
  double* data = new double[count];
  const nb::capsule owner(data, [](void* memory) noexcept { delete[] static_cast<double*>(memory); });
  return Out(data, sizeof...(sizes), shape, owner);
}

inline Out array_of(const double* values, Size count) {
  Out out = new_array(count);
  std::copy_n(values, count, out.data());
  return out;
}
inline Out array_of(const std::vector<double>& values) { return array_of(values.data(), values.size()); }
// Returns the doubles of a struct that has only doubles.
template <class Value>
Out array_of(const Value& value) {
  return array_of(reinterpret_cast<const double*>(&value), sizeof value / sizeof(double));
}

struct Box;
struct RootPose;
struct StepWeights;
template <class Kind, class... Kinds>
constexpr bool kOneOf = (std::is_same_v<Kind, Kinds> || ...);
template <class Kind>
constexpr bool kOfNumbers =
    kOneOf<Kind, Vec3<double>, Mat3<double>, Placed, Momentum, Box, RootPose, StepWeights>;

// The bindings of the other files, called by module.cpp.
void bind_clearance(nb::module_& m);
void bind_motions(nb::module_& m);
void bind_step(nb::module_& m);

}  // namespace ffsms

namespace nanobind::detail {

// Converts a contiguous array to a struct that has only doubles, the same number as the array.
template <class Kind>
struct type_caster<Kind, enable_if_t<ffsms::kOfNumbers<Kind>>> {
  NB_TYPE_CASTER(Kind, const_name("numpy.ndarray"))

  bool from_python(handle source, uint8_t flags, cleanup_list* cleanup) noexcept {
    make_caster<ffsms::In> array;
    if (!array.from_python(source, flags, cleanup)) return false;
    if (array.value.size() * sizeof(double) != sizeof value) return false;
    std::memcpy(&value, array.value.data(), sizeof value);
    return true;
  }
};

}  // namespace nanobind::detail
