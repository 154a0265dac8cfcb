// What Python sees of the kernel: shapes are checked here, the headers do the work.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_step(nb::module_& m);
void bind_sums(nb::module_& m);

NB_MODULE(_kernel, m) {
  m.doc() = "The compiled kernel; ffsms_pin.kernel is its face.";
  m.def("most_joints", [] { return 32; }, "The largest number of joints that the kernel takes.");
  bind_step(m);
  bind_sums(m);
}
