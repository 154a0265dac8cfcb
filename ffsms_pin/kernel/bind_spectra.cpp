// Singular values and entropies of stacks of matrices.
#include "arrays.hpp"
#include "bindings.hpp"
#include "entropy.hpp"
#include "singular.hpp"

namespace nb = nanobind;

namespace ffsms {
namespace {

// H_norm of matrices (rows, n), given as rows * n rows: one row, and as many of its gradient.
void entropies(int rows, int n, const In& coupling, const Out& value, const Out& gradient) {
  const Size count = coupling.shape(1);
  expect(rows >= 1 && rows <= kMostRows && n >= 1 && n <= kMostJoints, "too many rows or joints");
  expect_rows(coupling, rows * n, count);
  expect_rows(value, 1, count);
  expect_rows(gradient, rows * n, count);
  Pack C[kMostRows][kMostJoints], G[kMostRows][kMostJoints];
  for (Size k = 0; k < count; k += kLanes) {
    Reader read(coupling, k);
    for (int i = 0; i < rows; ++i) {
      for (int j = 0; j < n; ++j) C[i][j] = read.next();
    }
    Writer(value, k).put(entropy(rows, n, C, G));
    Writer write(gradient, k);
    for (int i = 0; i < rows; ++i) {
      for (int j = 0; j < n; ++j) write.put(G[i][j]);
    }
  }
}

// Singular values, the largest first, of matrices (rows, columns).
void spectra(int rows, int columns, const In& matrices, const Out& sigma) {
  const Size count = matrices.shape(1);
  const bool tall = rows >= columns;
  const int most = tall ? rows : columns, least = tall ? columns : rows;
  expect(least >= 1 && least <= kMostValues && most <= kMostJoints, "the matrices are too large");
  expect_rows(matrices, rows * columns, count);
  expect_rows(sigma, least, count);
  Pack A[kMostJoints][kMostValues], found[kMostValues];
  for (Size k = 0; k < count; k += kLanes) {
    Reader read(matrices, k);
    for (int i = 0; i < rows; ++i) {
      for (int j = 0; j < columns; ++j) (tall ? A[i][j] : A[j][i]) = read.next();
    }
    singular_values(A, most, least, found);
    Writer write(sigma, k);
    for (int i = 0; i < least; ++i) write.put(found[i]);
  }
}

}  // namespace

void bind_spectra(nb::module_& m) {
  const auto quiet = nb::call_guard<nb::gil_scoped_release>();
  m.def("entropies", &entropies, nb::arg("rows"), nb::arg("n"), nb::arg("coupling"), nb::arg("value"),
        nb::arg("gradient"), quiet);
  m.def("singular_values", &spectra, nb::arg("rows"), nb::arg("columns"), nb::arg("matrices"),
        nb::arg("sigma"), quiet);
}

}  // namespace ffsms
