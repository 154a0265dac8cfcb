// What the module is made of: each part binds itself.
#pragma once

#include <nanobind/nanobind.h>

namespace ffsms {

void bind_tree(nanobind::module_& m);
void bind_arm(nanobind::module_& m);
void bind_clearance(nanobind::module_& m);
void bind_slopes(nanobind::module_& m);
void bind_rollout(nanobind::module_& m);
void bind_spectra(nanobind::module_& m);
void bind_motions(nanobind::module_& m);
void bind_torques(nanobind::module_& m);
void bind_step(nanobind::module_& m);

}  // namespace ffsms
