// Renders random and degenerate models forward and backward with every instruction set of this CPU, for the sanitizers to watch.
#include <cmath>
#include <cstdio>
#include <random>
#include <vector>

#include "raster.h"

namespace {

using Floats = std::vector<float>;

struct Model {
  Floats means, quats, log_scales, logit_opacities, sh0, shN;
};

Model random_model(int count, int num_rest, bool degenerate, std::mt19937& random) {
  std::uniform_real_distribution<float> wide(-6.0f, 6.0f), unit(-1.0f, 1.0f);
  const auto filled = [&](int size, auto draw) {
    Floats numbers(static_cast<std::size_t>(size));
    for (float& number : numbers) number = draw();
    return numbers;
  };
  const auto one_of = [&](std::initializer_list<float> choices) { return choices.begin()[random() % choices.size()]; };
  return {
      filled(3 * count, [&] { return degenerate && random() % 4 == 0 ? one_of({0.0f, -12.0f, 1e4f, -1e7f, 1e30f}) : wide(random); }),
      filled(4 * count, [&] { return degenerate ? one_of({0.0f, 1e-38f, -1.0f, 1e18f, 1e38f}) : unit(random); }),
      filled(3 * count, [&] { return degenerate ? one_of({-60.0f, -3.0f, 0.0f, 3.0f, 60.0f, 1e30f}) : -2.0f + 1.5f * unit(random); }),
      filled(count, [&] { return degenerate ? one_of({-1e30f, -100.0f, 0.0f, 100.0f}) : 3.0f * unit(random); }),
      filled(3 * count, [&] { return unit(random); }),
      filled(3 * num_rest * count, [&] { return 0.2f * unit(random); }),
  };
}

radiant::View make_view(int width, int height, int degree, bool antialiased) {
  radiant::View view{};
  view.rotation[0] = view.rotation[4] = view.rotation[8] = 1;
  view.translation[2] = 12;
  view.center[2] = -12;
  view.fx = 50, view.fy = 55, view.cx = width / 2.0 + 3, view.cy = height / 2.0 - 2;
  view.near_m = 0.01, view.far_m = 1e10;
  view.width = width, view.height = height;
  view.tiles_x = (width + 15) / 16, view.tiles_y = (height + 15) / 16;
  view.sh_degree = degree;
  view.antialiased = antialiased;
  return view;
}

bool all_finite(const Floats& numbers) {
  for (const float number : numbers)
    if (!std::isfinite(number)) return false;
  return true;
}

// Exact sizes, so that a write beyond any array is seen.
bool run(const radiant::Kernels& kernels, const radiant::View& view, const Model& m, int num_rest, int threads) {
  const std::size_t count = m.logit_opacities.size(), pixels = static_cast<std::size_t>(view.width) * static_cast<std::size_t>(view.height);
  const radiant::SplatArrays splats{static_cast<std::int64_t>(count), num_rest, m.means.data(), m.quats.data(), m.log_scales.data(),
                                    m.logit_opacities.data(), m.sh0.data(), m.shN.data()};
  Floats images(3 * pixels), alphas(pixels), depths(pixels), means2d(2 * count), radii(count), ones(3 * pixels, 1.0f), moved(2 * count), absgrad(2 * count), weights(count);
  std::vector<radiant::Moments> sums(count);
  radiant::RenderedView rendered;
  rendered.forward(kernels, view, splats, {images.data(), alphas.data(), depths.data(), means2d.data(), radii.data()}, true, threads);
  for (const bool absolute : {false, true})
    rendered.blend_backward({ones.data(), ones.data(), ones.data(), alphas.data(), depths.data()}, moved.data(), sums.data(),
                            absolute ? absgrad.data() : nullptr, absolute ? weights.data() : nullptr, threads);
  Floats g[6] = {Floats(m.means.size()), Floats(m.quats.size()), Floats(m.log_scales.size()), Floats(count), Floats(m.sh0.size()), Floats(m.shN.size())};
  for (const bool add : {false, true})
    rendered.project_backward(splats, moved.data(), sums.data(), {g[0].data(), g[1].data(), g[2].data(), g[3].data(), g[4].data(), g[5].data(), add}, threads);
  bool finite = all_finite(images) && all_finite(alphas) && all_finite(depths) && all_finite(radii) && all_finite(absgrad) && all_finite(weights);
  for (const Floats& gradient : g) finite = finite && all_finite(gradient);
  return finite;
}

}  // namespace

int main() {
  std::mt19937 random(1);
  int failed = 0;
  for (const char* name : {"avx512", "avx2", "portable"}) {
    const radiant::Kernels* kernels = radiant::find_kernels(name);
    if (!kernels) continue;
    for (const int count : {0, 1, 15, 16, 17, 700, 3000})
      for (int degree = 0; degree < 4; ++degree)
        for (const bool degenerate : {false, true}) {
          const int num_rest = (degree + 1) * (degree + 1) - 1;
          const Model model = random_model(count, num_rest, degenerate, random);
          for (const bool antialiased : {false, true})
            if (!run(*kernels, make_view(1 + static_cast<int>(random() % 90), 1 + static_cast<int>(random() % 60), degree, antialiased), model, num_rest, 3)) {
              std::printf("%s: %d Gaussians, degree %d, degenerate %d, antialiased %d: not finite\n", name, count, degree, degenerate, antialiased);
              ++failed;
            }
        }
  }
  return failed ? 1 : 0;
}
