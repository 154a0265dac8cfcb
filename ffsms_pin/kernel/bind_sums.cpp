// Python's arrays to the sums of `sums.hpp`.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <deque>
#include <utility>
#include <vector>

#include "bindings.hpp"
#include "sums.hpp"

namespace nb = nanobind;

namespace {

using Array = nb::ndarray<const double, nb::device::cpu>;
using Packed = nb::ndarray<const double, nb::c_contig, nb::device::cpu>;
using Indices = nb::ndarray<const std::int64_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// What was handed over, in forms that the sums can read, kept until they are done.
class Arrays {
 public:
  // Axes at the end: motion and instant, or the entry alone; before them the joints, where there are some.
  ffsms::Strided strided(nb::handle object, bool joints, bool entries = false) {
    const Array& array = arrays_.emplace_back(nb::cast<Array>(object));
    std::size_t axis = array.ndim();
    const auto step = [&] { return axis-- > 0 && array.shape(axis) > 1 ? array.stride(axis) : 0; };
    ffsms::Strided out;
    out.data = array.data();
    out.instant = step();
    if (!entries) out.motion = step();
    if (joints) out.joint = step();
    if (axis > 0) out.component = step();
    return out;
  }

  const Packed& packed(nb::handle object) { return packed_.emplace_back(nb::cast<Packed>(object)); }

  const Indices& indices(nb::handle object) { return indices_.emplace_back(nb::cast<Indices>(object)); }

 private:
  std::deque<Array> arrays_;
  std::deque<Packed> packed_;
  std::deque<Indices> indices_;
};

ffsms::SplineMaps spline_of(Arrays& arrays, const nb::tuple& given) {
  ffsms::SplineMaps out;
  const Packed& rates = arrays.packed(given[0]);
  out.rates = rates.data();
  out.travel = arrays.packed(given[1]).data();
  out.accelerations = arrays.packed(given[2]).data();
  out.to_points = arrays.packed(given[3]).data();
  const Packed& over = arrays.packed(given[4]);
  out.over = over.data();
  out.late = nb::cast<int>(given[5]);
  out.size = static_cast<int>(rates.shape(1));
  out.intervals = static_cast<int>(over.shape(0));
  out.gauss = static_cast<int>(over.shape(1));
  return out;
}

ffsms::ArmMotions arm_of(Arrays& arrays, const nb::tuple& given) {
  ffsms::ArmMotions out;
  out.mass = nb::cast<double>(given[0]);
  out.base_com = arrays.packed(given[1]).data();
  const Packed& moves_tip = arrays.packed(given[2]);
  out.moves_tip = moves_tip.data();
  out.joints = static_cast<int>(moves_tip.shape(0));
  const auto vector = [&](int i) { return arrays.strided(given[i], false); };
  const auto columns = [&](int i) {
    return given[i].is_none() ? ffsms::Strided() : arrays.strided(given[i], true);
  };
  out.own_spin = vector(3), out.com = vector(4), out.tip = vector(5);
  out.rates = columns(6), out.attitude = columns(7);
  out.spin = columns(8), out.jstar = columns(9), out.axes = columns(10), out.linear = columns(11);
  out.spin_q = columns(12), out.jstar_q = columns(13), out.tip_spin_q = columns(14);
  out.entropy_q = columns(15);
  return out;
}

ffsms::Residual residual_of(Arrays& arrays, const nb::tuple& given) {
  ffsms::Residual out;
  const Indices& instants = arrays.indices(given[0]);
  out.count = static_cast<std::ptrdiff_t>(instants.shape(0));
  out.instants = instants.data();
  const bool entries = !given[1].is_none();
  out.motion = entries ? arrays.indices(given[1]).data() : nullptr;
  out.weight = arrays.packed(given[2]).data();
  out.value = arrays.strided(given[3], false, entries);
  const std::pair<const char*, ffsms::Strided*> named[] = {
      {"by_joints", &out.by_joints},
      {"by_rates", &out.by_rates},
      {"by_accelerations", &out.by_accelerations},
      {"by_tip", &out.by_tip},
      {"by_turn", &out.by_turn},
      {"by_velocity", &out.by_velocity},
      {"by_spin", &out.by_spin},
      {"by_base", &out.by_base},
      {"by_base_turn", &out.by_base_turn},
      {"by_base_spin", &out.by_base_spin},
      {"by_entropy", &out.by_entropy},
  };
  std::size_t index = 0;
  const nb::dict slopes = nb::cast<nb::dict>(given[4]);
  for (const auto& [name, slope] : named) {
    const bool joints = index++ < 3;
    if (slopes.contains(name)) *slope = arrays.strided(slopes[name], joints, entries);
  }
  return out;
}

ffsms::JointResidual joints_of(Arrays& arrays, const nb::tuple& given) {
  ffsms::JointResidual out;
  const Packed& weight = arrays.packed(given[0]);
  out.count = static_cast<std::ptrdiff_t>(weight.shape(0));
  out.weight = weight.data();
  const auto part = [&](int i) {
    return given[i].is_none() ? ffsms::Strided() : arrays.strided(given[i], true);
  };
  out.value = part(1), out.by_position = part(2), out.by_rate = part(3), out.by_acceleration = part(4);
  return out;
}

void sums(const nb::tuple& spline, const nb::tuple& arm, const nb::list& residuals, const nb::list& of_joints,
          const Indices& chosen, nb::ndarray<double, nb::ndim<2>, nb::c_contig> gradient,
          nb::ndarray<double, nb::ndim<3>, nb::c_contig> hessian) {
  Arrays arrays;
  const ffsms::SplineMaps maps = spline_of(arrays, spline);
  const ffsms::ArmMotions motions = arm_of(arrays, arm);
  std::vector<ffsms::Residual> values;
  std::vector<ffsms::JointResidual> single;
  for (nb::handle one : residuals) values.push_back(residual_of(arrays, nb::cast<nb::tuple>(one)));
  for (nb::handle one : of_joints) single.push_back(joints_of(arrays, nb::cast<nb::tuple>(one)));
  ffsms::Sums all(maps, motions);
  const std::size_t size = gradient.shape(1);
  for (std::size_t i = 0; i < chosen.shape(0); i++)
    all.add(chosen(i), values, single, gradient.data() + i * size, hessian.data() + i * size * size);
}

}  // namespace

void ffsms::bind_sums(nb::module_& m) { m.def("sums", &sums); }
