// What Python sees of the kernel: shapes are checked in the bindings, the headers do the work.
#include "arrays.hpp"

NB_MODULE(_kernel, m) {
  nanobind::set_leak_warnings(false);  // what Python's own caches still hold at its end is no leak
  m.doc() = "The compiled kernel; ffsms_pin.kernel is its face.";
  ffsms::bind_stacks(m);
  ffsms::bind_clearance(m);
  ffsms::bind_motions(m);
  ffsms::bind_step(m);
}
