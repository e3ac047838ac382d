// Checks every array and every index, lets go of the interpreter lock, calls the loop.
#include <nanobind/ndarray.h>

#include <cstdint>
#include <string>

#include "training/bind.h"
#include "training/rows.h"

namespace nb = nanobind;
using nb::literals::operator""_a;

namespace {

template <class Value, int kDims>
using Table = nb::ndarray<Value, nb::ndim<kDims>, nb::c_contig, nb::device::cpu>;
using Rows = Table<const std::int64_t, 1>;

[[noreturn]] void raise(const std::string& message) { throw nb::value_error(message.c_str()); }

void check_rows(const Rows& rows, std::size_t count, std::size_t below) {
  if (rows.shape(0) != count) raise(std::to_string(rows.shape(0)) + " rows are named for " + std::to_string(count));
  for (std::size_t i = 0; i < count; ++i) {
    if (rows.data()[i] < 0 || rows.data()[i] >= static_cast<std::int64_t>(below)) {
      raise("row " + std::to_string(rows.data()[i]) + " is named, expected 0 to " + std::to_string(below) + " exclusive");
    }
  }
}

void check_columns(std::int64_t first, std::size_t width, std::size_t columns) {
  if (first < 0 || static_cast<std::size_t>(first) + width > columns) {
    raise("columns " + std::to_string(first) + " and " + std::to_string(width) + " more are outside of " + std::to_string(columns));
  }
}

void gather_rows(const Table<const float, 2>& source, const Rows& rows, const Table<float, 2>& target, std::int64_t first) {
  check_rows(rows, target.shape(0), source.shape(0));
  check_columns(first, source.shape(1), target.shape(1));
  const nb::gil_scoped_release unlocked;
  radiant::gather_rows(source.data(), source.shape(1), rows.data(), rows.shape(0), target.data(), target.shape(1), first);
}

void add_rows(const Table<float, 2>& target, const Rows& at, const Table<const float, 2>& values) {
  check_rows(at, values.shape(0), target.shape(0));
  if (values.shape(1) != target.shape(1)) raise("values and target differ in columns");
  const nb::gil_scoped_release unlocked;
  radiant::add_rows(target.data(), at.data(), at.shape(0), values.data(), values.shape(1));
}

void spread_rows(const Table<const float, 2>& values, std::int64_t first, const Rows& rows, float scale, const Table<float, 2>& target) {
  check_rows(rows, values.shape(0), target.shape(0));
  for (std::size_t i = 1; i < rows.shape(0); ++i)
    if (rows.data()[i] <= rows.data()[i - 1]) raise("rows to spread do not ascend");
  check_columns(first, target.shape(1), values.shape(1));
  const nb::gil_scoped_release unlocked;
  radiant::spread_rows(values.data(), values.shape(1), first, rows.data(), rows.shape(0), scale, target.data(), target.shape(0), target.shape(1));
}

void to_bfloat16(const Table<const float, 2>& values, const Table<std::uint16_t, 2>& target) {
  if (values.size() != target.size()) raise("values and target differ in size");
  const nb::gil_scoped_release unlocked;
  radiant::to_bfloat16(values.data(), values.size(), target.data());
}

void from_bfloat16(const Table<const std::uint16_t, 2>& values, const Table<float, 2>& target) {
  if (values.size() != target.size()) raise("values and target differ in size");
  const nb::gil_scoped_release unlocked;
  radiant::from_bfloat16(values.data(), values.size(), target.data());
}

void check_groups(const Rows& bounds, std::size_t columns) {
  if (bounds.shape(0) < 2 || bounds.data()[0] != 0) raise("groups of columns are bounded by 0 and their ends");
  for (std::size_t i = 1; i < bounds.shape(0); ++i)
    if (bounds.data()[i] <= bounds.data()[i - 1]) raise("the bounds of groups do not ascend");
  if (static_cast<std::size_t>(bounds.data()[bounds.shape(0) - 1]) != columns) raise("the last group does not end with the columns");
}

template <class Values, class Exponents, class Fractions>
void check_blocks(const Values& values, const Rows& bounds, const Exponents& exponents, const Fractions& fractions) {
  check_groups(bounds, values.shape(1));
  if (exponents.shape(0) != values.shape(0) || exponents.shape(1) != bounds.shape(0) - 1) raise("one exponent is needed per row and group");
  if (fractions.shape(0) != values.shape(0) || fractions.shape(1) != values.shape(1)) raise("values and fractions differ in shape");
}

void to_blocks(const Table<const float, 2>& values, const Rows& bounds, const Table<std::uint8_t, 2>& exponents,
               const Table<std::int8_t, 2>& fractions) {
  check_blocks(values, bounds, exponents, fractions);
  const nb::gil_scoped_release unlocked;
  radiant::to_blocks(values.data(), values.shape(0), values.shape(1), bounds.data(), bounds.shape(0) - 1, exponents.data(), fractions.data());
}

void from_blocks(const Table<const std::uint8_t, 2>& exponents, const Table<const std::int8_t, 2>& fractions, const Rows& bounds,
                 const Table<float, 2>& values) {
  check_blocks(values, bounds, exponents, fractions);
  const nb::gil_scoped_release unlocked;
  radiant::from_blocks(exponents.data(), fractions.data(), values.shape(0), values.shape(1), bounds.data(), bounds.shape(0) - 1, values.data());
}

}  // namespace

void bind_rows(nb::module_& module) {
  module.def("gather_rows", &gather_rows, "source"_a, "rows"_a, "target"_a.noconvert(), "first"_a,
             "Writes rows (R,) int64 of source (N,W) float32 into the columns of target (R,K) float32 from `first` on.\n\n"
             "Raises ValueError for an index or a column that is not there, as do the functions beside it.");
  module.def("add_rows", &add_rows, "target"_a.noconvert(), "at"_a, "values"_a,
             "Adds values (R,K) float32 to the rows at (R,) int64 of target (T,K) float32, in their order.");
  module.def("spread_rows", &spread_rows, "values"_a, "first"_a, "rows"_a, "scale"_a, "target"_a.noconvert(),
             "Writes `scale` times W columns of values (R,K) float32, from `first` on, into rows (R,) int64, ascending, of target (N,W) float32;\n"
             "the other rows become 0.");
  module.def("to_bfloat16", &to_bfloat16, "values"_a, "target"_a.noconvert(),
             "Writes the nearest bfloat16 of values (R,K) float32 into target (R,K) uint16, ties to even.");
  module.def("to_blocks", &to_blocks, "values"_a, "bounds"_a, "exponents"_a.noconvert(), "fractions"_a.noconvert(),
             "Writes values (R,K) float32 as exponents (R,G) uint8, biased by 64, of groups of columns that end at bounds (G+1,) int64,\n"
             "and fractions (R,K) int8 in units of 2^(exponent - 7).");
  module.def("from_blocks", &from_blocks, "exponents"_a, "fractions"_a, "bounds"_a, "values"_a.noconvert(),
             "Writes what `to_blocks` made into values (R,K) float32.");
  module.def("from_bfloat16", &from_bfloat16, "values"_a, "target"_a.noconvert(), "Writes bfloat16 values (R,K) uint16 into target (R,K) float32.");
}
