// Singular values and entropies of stacks of matrices.
#include "arrays.hpp"
#include "bindings.hpp"
#include "entropy.hpp"
#include "singular.hpp"

namespace nb = nanobind;

namespace ffsms {
namespace {

template <class T>
struct Work {
  T C[kMostRows][kMostJoints], gradient[kMostRows][kMostJoints], value;
  T A[kMostJoints][kMostValues], row[kMostJoints], sigma[kMostValues];
};

// H_norm of matrices (rows, n), given as rows * n rows: one row, and as many of its gradient.
void entropies(int rows, int n, const In& coupling, const Out& value, const Out& gradient) {
  const Size count = coupling.shape(1);
  expect(rows >= 1 && rows <= kMostRows && n >= 1 && n <= kMostJoints, "too many rows or joints");
  expect_rows(coupling, rows * n, count);
  expect_rows(value, 1, count);
  expect_rows(gradient, rows * n, count);
  along<Work>(count, [&](auto& work, Size k) {
    Reader read(coupling, k);
    for (int i = 0; i < rows; ++i) read.next(work.C[i], n);
    work.value = entropy(rows, n, work.C, work.gradient);
    Writer(value, k).put(&work.value, 1);
    Writer write(gradient, k);
    for (int i = 0; i < rows; ++i) write.put(work.gradient[i], n);
  });
}

// Singular values, the largest first, of matrices (rows, columns).
void spectra(int rows, int columns, const In& matrices, const Out& sigma) {
  const Size count = matrices.shape(1);
  const bool tall = rows >= columns;
  const int most = tall ? rows : columns, least = tall ? columns : rows;
  expect(least >= 1 && least <= kMostValues && most <= kMostJoints, "the matrices are too large");
  expect_rows(matrices, rows * columns, count);
  expect_rows(sigma, least, count);
  along<Work>(count, [&](auto& work, Size k) {
    Reader read(matrices, k);
    for (int i = 0; i < rows; ++i) {
      read.next(work.row, columns);
      for (int j = 0; j < columns; ++j) (tall ? work.A[i][j] : work.A[j][i]) = work.row[j];
    }
    singular_values(work.A, most, least, work.sigma);
    Writer(sigma, k).put(work.sigma, least);
  });
}

}  // namespace

void bind_spectra(nb::module_& m) {
  const auto quiet = nb::call_guard<nb::gil_scoped_release>();
  m.def("entropies", &entropies, nb::arg("rows"), nb::arg("n"), nb::arg("coupling"),
        nb::arg("value").noconvert(), nb::arg("gradient").noconvert(), quiet);
  m.def("singular_values", &spectra, nb::arg("rows"), nb::arg("columns"), nb::arg("matrices"),
        nb::arg("sigma").noconvert(), quiet);
}

}  // namespace ffsms
