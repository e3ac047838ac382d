#include "plan/camera_tree.h"

#include <numeric>

namespace radiant {
namespace {

// Bits of a 16-bit number with a zero after each.
std::uint32_t spread_bits(std::uint32_t value) {
  value = (value | (value << 8)) & 0x00ff00ffu;
  value = (value | (value << 4)) & 0x0f0f0f0fu;
  value = (value | (value << 2)) & 0x33333333u;
  return (value | (value << 1)) & 0x55555555u;
}

// Rows in Morton order of a grid of 65,536² over their bounding square, then by coordinates.
std::vector<std::uint32_t> curve_order(const double* positions, const std::vector<std::uint32_t>& rows) {
  double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
  for (const std::uint32_t row : rows)
    for (int axis = 0; axis < 2; ++axis) {
      low[axis] = std::min(low[axis], positions[2 * row + axis]);
      high[axis] = std::max(high[axis], positions[2 * row + axis]);
    }
  const double side = std::max(high[0] - low[0], high[1] - low[1]);
  const double scale = side > 0 ? 65535.0 / side : 0.0;
  struct Keyed {
    std::uint32_t key, row;
  };
  std::vector<Keyed> now(rows.size()), next(rows.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const double* at = positions + 2 * static_cast<std::size_t>(rows[i]);
    // A side that is denormal makes the scale infinite: everything is one spot then.
    const double u = std::isfinite(scale) ? (at[0] - low[0]) * scale : 0.0, v = std::isfinite(scale) ? (at[1] - low[1]) * scale : 0.0;
    now[i] = {spread_bits(static_cast<std::uint32_t>(u)) | (spread_bits(static_cast<std::uint32_t>(v)) << 1), rows[i]};
  }
  for (int shift = 0; shift < 33; shift += 11) {
    std::vector<std::size_t> start(2049, 0);
    for (const Keyed& item : now) ++start[((item.key >> shift) & 2047u) + 1];
    std::partial_sum(start.begin(), start.end(), start.begin());
    for (const Keyed& item : now) next[start[(item.key >> shift) & 2047u]++] = item;
    now.swap(next);
  }
  std::vector<std::uint32_t> order(rows.size());
  for (std::size_t begin = 0, end = 0; begin < now.size(); begin = end) {
    while (end < now.size() && now[end].key == now[begin].key) ++end;
    if (end - begin > 1) {
      std::sort(now.begin() + begin, now.begin() + end, [positions](const Keyed& a, const Keyed& b) {
        const double *p = positions + 2 * static_cast<std::size_t>(a.row), *r = positions + 2 * static_cast<std::size_t>(b.row);
        if (p[0] != r[0]) return p[0] < r[0];
        if (p[1] != r[1]) return p[1] < r[1];
        return a.row < b.row;
      });
    }
    for (std::size_t i = begin; i < end; ++i) order[i] = now[i].row;
  }
  return order;
}

CameraBox leaf_box(const CameraTree& tree, std::size_t first, std::size_t last) {
  double low_x = INFINITY, high_x = -INFINITY, low_y = INFINITY, high_y = -INFINITY, sum_x = 0, sum_y = 0;
  std::int64_t cameras = 0;
  for (std::size_t u = first; u < last; ++u) {
    low_x = std::min(low_x, tree.x[u]), high_x = std::max(high_x, tree.x[u]);
    low_y = std::min(low_y, tree.y[u]), high_y = std::max(high_y, tree.y[u]);
    sum_x += tree.x[u] * static_cast<double>(tree.cameras[u]), sum_y += tree.y[u] * static_cast<double>(tree.cameras[u]);
    cameras += tree.cameras[u];
  }
  const double count = static_cast<double>(cameras);
  return {(low_x + high_x) / 2, (low_y + high_y) / 2, (high_x - low_x) / 2, (high_y - low_y) / 2, sum_x / count, sum_y / count, cameras};
}

CameraBox joined(const CameraBox* boxes, std::size_t count) {
  double low_x = INFINITY, high_x = -INFINITY, low_y = INFINITY, high_y = -INFINITY, sum_x = 0, sum_y = 0;
  std::int64_t cameras = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const CameraBox& box = boxes[i];
    low_x = std::min(low_x, box.centre_x - box.half_x), high_x = std::max(high_x, box.centre_x + box.half_x);
    low_y = std::min(low_y, box.centre_y - box.half_y), high_y = std::max(high_y, box.centre_y + box.half_y);
    sum_x += box.mean_x * static_cast<double>(box.cameras), sum_y += box.mean_y * static_cast<double>(box.cameras);
    cameras += box.cameras;
  }
  const double total = static_cast<double>(cameras);
  return {(low_x + high_x) / 2, (low_y + high_y) / 2, (high_x - low_x) / 2, (high_y - low_y) / 2, sum_x / total, sum_y / total, cameras};
}

}  // namespace

CameraTree::CameraTree(const double* positions, const std::int64_t* multiplicities, std::size_t num_positions) {
  std::vector<std::uint32_t> rows;
  rows.reserve(num_positions);
  for (std::size_t row = 0; row < num_positions; ++row)
    if (!multiplicities || multiplicities[row] > 0) rows.push_back(static_cast<std::uint32_t>(row));
  inputs = curve_order(positions, rows);
  x.reserve(inputs.size()), y.reserve(inputs.size()), cameras.reserve(inputs.size()), first_input.reserve(inputs.size() + 1);
  for (std::size_t i = 0; i < inputs.size(); ++i) {
    const double px = positions[2 * static_cast<std::size_t>(inputs[i])], py = positions[2 * static_cast<std::size_t>(inputs[i]) + 1];
    if (x.empty() || px != x.back() || py != y.back()) {
      x.push_back(px), y.push_back(py), cameras.push_back(0), first_input.push_back(i);
    }
    cameras.back() += multiplicities ? multiplicities[inputs[i]] : 1;
  }
  first_input.push_back(inputs.size());
  if (x.empty()) return;
  std::vector<CameraBox> leaves;
  leaves.reserve(x.size() / kLeaf + 1);
  for (std::size_t first = 0; first < x.size(); first += kLeaf) leaves.push_back(leaf_box(*this, first, std::min(first + kLeaf, x.size())));
  levels.push_back(std::move(leaves));
  while (levels.back().size() > 1) {
    const auto& below = levels.back();
    std::vector<CameraBox> above;
    for (std::size_t first = 0; first < below.size(); first += kFan)
      above.push_back(joined(&below[first], std::min(kFan, below.size() - first)));
    levels.push_back(std::move(above));
  }
}

std::pair<std::size_t, std::size_t> CameraTree::units_of(std::size_t level, std::size_t index) const {
  std::size_t size = kLeaf;
  for (std::size_t l = 0; l < level; ++l) size *= kFan;
  return {index * size, std::min((index + 1) * size, num_units())};
}

}  // namespace radiant
