// Which parts of bodies may be near each other: for `opt/limits/clearance`.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <vector>

#include "arrays.hpp"
#include "clearance.hpp"
#include "points.hpp"

namespace nb = nanobind;

namespace ffsms {
namespace {

template <class T, int... shape>
using Array = nb::ndarray<const T, nb::shape<shape...>, nb::c_contig, nb::device::cpu>;
using Index = std::int64_t;

struct Candidate {
  Index entry, pair;
  double bound;
};

// A copy of values that Python owns.
template <class T>
nb::object given(const std::vector<T>& values, std::initializer_list<std::size_t> shape) {
  T* data = new T[values.size()];
  std::copy(values.begin(), values.end(), data);
  const nb::capsule owner(data, [](void* memory) noexcept { delete[] static_cast<T*>(memory); });
  return nb::cast(nb::ndarray<nb::numpy, T>(data, shape, owner));
}

nb::tuple near_parts(Array<double, 3, 3, -1, -1> rotations, Array<double, 3, -1, -1> origins,
                     Array<Index, -1> columns, Array<Index, -1> at, Array<double, -1> near,
                     Array<double, -1, 17> bodies, Array<double, -1, 17> parts, Array<Index, -1, 2> ends,
                     Array<Index, -1> starts, Array<Index, -1, 2> pairs, Array<double, -1, 3> corners,
                     Array<Index, -1> begins,
                     nb::ndarray<double, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu> directions) {
  const Bodies seen{rotations.data(), origins.data(), static_cast<Index>(origins.shape(1)),
                    static_cast<Index>(origins.shape(2))};
  const auto* body = reinterpret_cast<const Cover*>(bodies.data());
  const auto* part = reinterpret_cast<const Cover*>(parts.data());
  const std::size_t size = columns.shape(0);
  std::vector<double> least(size), turns, ways;
  std::vector<Candidate> found;
  std::vector<Index> used;
  for (std::size_t v = 0; v < size; ++v) {
    const Index m = columns(v), k = at(v);
    const Cover &one = body[ends(m, 0)], &other = body[ends(m, 1)];
    const Relative relative(seen, seen.index(one), seen.index(other), k);
    least[v] = bound(one, other, relative, near(v));
    if (!(least[v] < near(v))) continue;
    const std::size_t before = found.size();
    double nearest = std::numeric_limits<double>::infinity();
    const auto corners_of = [&](Index p) {
      return Corners{corners.data() + 3 * begins(p), begins(p + 1) - begins(p)};
    };
    for (Index i = starts(m); i < starts(m + 1); ++i) {
      const Index p = pairs(i, 0), q = pairs(i, 1);
      double low = bound(part[p], part[q], relative, near(v));
      if (low < near(v) && std::isfinite(near(v))) {
        const Corners first = corners_of(p), second = corners_of(q);
        if (first.count > 0 && second.count > 0)
          low = std::max(low, gap(first, second, relative, near(v), &directions(i, 0)));
      }
      nearest = std::min(nearest, low);
      if (low < near(v)) found.push_back({static_cast<Index>(v), i, low});
    }
    least[v] = std::max(least[v], nearest);
    if (found.size() == before) continue;
    least[v] = near(v);
    // The nearest first: those behind them often need not be measured.
    std::stable_sort(found.begin() + static_cast<std::ptrdiff_t>(before), found.end(),
                     [](const Candidate& a, const Candidate& b) { return a.bound < b.bound; });
    used.push_back(static_cast<Index>(v));
    turns.insert(turns.end(), relative.turn, relative.turn + 9);
    ways.insert(ways.end(), relative.way, relative.way + 3);
  }
  std::vector<Index> entries(found.size()), chosen(found.size());
  std::vector<double> bounds(found.size());
  for (std::size_t i = 0; i < found.size(); ++i) {
    entries[i] = found[i].entry;
    chosen[i] = found[i].pair;
    bounds[i] = found[i].bound;
  }
  const std::size_t count = found.size(), close = used.size();
  return nb::make_tuple(given(least, {size}), given(entries, {count}), given(chosen, {count}),
                        given(bounds, {count}), given(used, {close}), given(turns, {close, 3, 3}),
                        given(ways, {close, 3}));
}

// Distances (m) and gradients (m, n) at joint positions (n); `box` (5, 3): three rows of its rotation, its
// centre, half of its sides.
nb::tuple points(const Tree& tree, Array<double, -1> positions, Array<Index, -1> there, Array<Index, -1> here,
                 Array<double, -1, -1> moves, Array<double, -1, -1> holds, Array<double, 5, 3> box) {
  const std::size_t count = there.shape(0), n = static_cast<std::size_t>(tree.n);
  expect(positions.shape(0) == n && here.shape(0) == count && moves.shape(0) == count &&
             moves.shape(1) == n && holds.shape(0) == count && holds.shape(1) == n,
         "an array has a wrong shape");
  Arm<double> arm;
  evaluate(tree, positions.data(), arm);
  Box around;
  std::memcpy(around.rotation.m, box.data(), sizeof around.rotation.m);
  std::memcpy(around.centre.v, box.data() + 9, sizeof around.centre.v);
  std::memcpy(around.half.v, box.data() + 12, sizeof around.half.v);
  std::vector<double> distance(count), gradient(count * n);
  point_clearances(tree, arm, there.data(), here.data(), moves.data(), holds.data(), around,
                   static_cast<int>(count), distance.data(), gradient.data());
  return nb::make_tuple(given(distance, {count}), given(gradient, {count, n}));
}

}  // namespace

void bind_clearance(nb::module_& m) {
  m.def("point_clearances", &points, nb::arg("tree"), nb::arg("positions"), nb::arg("there"), nb::arg("here"),
        nb::arg("moves"), nb::arg("holds"), nb::arg("box"));
  m.def(
      "near_parts", &near_parts, nb::arg("rotations"), nb::arg("origins"), nb::arg("columns"), nb::arg("at"),
      nb::arg("near"), nb::arg("bodies"), nb::arg("parts"), nb::arg("ends"), nb::arg("starts"),
      nb::arg("pairs"), nb::arg("corners"), nb::arg("begins"), nb::arg("directions"),
      "Of V entries (pair of bodies, configuration): bounds (V,) from below on distances, `near` where parts "
      "may be nearer; these parts, as entries, pairs of parts and bounds (C,), the nearest of each entry "
      "first; and of the entries (U,) that have some the second body as the first sees it, turns (U, 3, 3) "
      "and ways (U, 3).");
}

}  // namespace ffsms
