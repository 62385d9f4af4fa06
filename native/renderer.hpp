// Virtual views of a light field, over a plane or depth maps, blended by tiles or by the Delaunay
// mesh, and what they cost against a camera image. The readable version is
// pipelines/render/reference.py.

#pragma once

#include <algorithm>
#include <memory>
#include <span>
#include <vector>

#include "blending.hpp"
#include "comparison.hpp"
#include "delaunay_blending.hpp"
#include "depth_surface.hpp"
#include "hole_filling.hpp"
#include "homography.hpp"
#include "level.hpp"
#include "normalisation.hpp"
#include "regions.hpp"
#include "sampling.hpp"
#include "surface.hpp"
#include "tiles.hpp"
#include "virtual_views.hpp"

namespace lfnav::LFNAV_LEVEL {

constexpr std::size_t SLOTS = 16;
constexpr std::int32_t END = -1;
static_assert(MOST_BLENDED < SLOTS);

/// Renders one virtual view after the other; what it needs for that it makes once.
class ViewRenderer {
  public:
    ViewRenderer(const LightField& field, const VirtualViews& views)
        : field_(field),
          views_(views),
          middle_{static_cast<std::int32_t>(views.width / 2),
                  static_cast<std::int32_t>(views.height / 2)},
          surface_(surface_of(field, views)),
          blending_(blending_of(field, views, middle_, *surface_)),
          homographies_(field.photos, middle_),
          shown_(field.photos.count),
          first_(field.photos.count, END),
          pixels_(views.pixels.size()),
          seen_(views.pixels.size()),
          inverse_depth_(views.pixels.size() + TOGETHER) {
        const auto width = static_cast<std::int32_t>(views.width);
        for (std::size_t i = 0; i < seen_.size(); ++i) {
            const std::int32_t column = views.pixels[i] % width, row = views.pixels[i] / width;
            pixels_.x[i] = static_cast<float>(column);
            pixels_.y[i] = static_cast<float>(row);
        }
        surface_->prepare(pixels_);
    }

    /// Renders a view.
    ///
    /// @param image: (P, 4) receives it, see render().
    void draw(std::size_t number, float* image) {
        const VirtualCamera camera(views_.poses + 16 * number, views_.intrinsics);
        surface_->set_camera(camera, number);
        surface_->set_inverse_depths(pixels_, seen_.data());
        homographies_.begin(camera);
        blending_->choose(camera, *surface_, homographies_);
        const RegionMap& map = blending_->map();
        const std::vector<std::int32_t>& place = map.pixels().place;
        for (std::size_t i = 0; i < seen_.size(); ++i) {
            inverse_depth_[i] = seen_[static_cast<std::size_t>(place[i])];
        }
        std::fill_n(image, 4 * seen_.size(), 0.0F);
        if (field_.photos.has_depth) {
            blend_regions<true>(camera, map, image);
        } else {
            blend_regions<false>(camera, map, image);
        }
        if (normalise(image, seen_.size(), field_.smallest_weight) > 0) {
            fill_holes(camera, image);
        }
    }

    /// The inverse depths at the pixels of the view that was drawn last.
    std::span<const float> inverse_depths() const { return seen_; }

  private:
    static std::unique_ptr<Surface> surface_of(const LightField& field, const VirtualViews& views) {
        if (views.samples) {
            return std::make_unique<DepthSurface>(field, views, *views.samples);
        }
        return std::make_unique<PlaneSurface>(field.plane);
    }

    static std::unique_ptr<Blending> blending_of(const LightField& field, const VirtualViews& views,
                                                 const Middle& middle, const Surface& surface) {
        if (field.has_mesh) {
            return std::make_unique<DelaunayBlending>(field, views, middle, surface);
        }
        return std::make_unique<Tiling>(field, views, middle, surface);
    }

    /// Chains the regions that show the same photo; returns how many photos any region shows.
    LFNAV_INLINE std::size_t chain_regions(const RegionMap& map) {
        const std::span<const Region> regions = map.regions();
        const std::vector<std::size_t>& starts = map.pixels().starts;
        next_.resize(std::max(next_.size(), SLOTS * regions.size()));
        std::size_t count = 0;
        // From the last to the first, so that each chain runs from the first to the last.
        for (std::size_t number = regions.size(); number-- > 0;) {
            if (starts[number] == starts[number + 1]) {
                continue;
            }
            const Region& region = regions[number];
            for (std::size_t slot = 0; slot < region.count; ++slot) {
                const auto photo = static_cast<std::size_t>(region.photo[slot]);
                if (first_[photo] == END) {
                    shown_[count++] = photo;
                }
                const std::size_t entry = SLOTS * number + slot;
                next_[entry] = first_[photo];
                first_[photo] = static_cast<std::int32_t>(entry);
            }
        }
        // What a pixel shows must not depend on which regions others are in.
        std::sort(shown_.begin(), shown_.begin() + static_cast<std::ptrdiff_t>(count));
        return count;
    }

    /// Adds to each pixel what the photos of its region show, photo by photo.
    ///
    /// @tparam MAY_BE_HIDDEN: whether depth maps may hide the surface.
    template <bool MAY_BE_HIDDEN>
    LFNAV_INLINE void blend_regions(const VirtualCamera& camera, const RegionMap& map,
                                    float* image) {
        const std::span<const Region> regions = map.regions();
        const std::vector<std::size_t>& starts = map.pixels().starts;
        const std::size_t shown = chain_regions(map);
        for (std::size_t number = 0; number < shown; ++number) {
            const std::size_t photo = shown_[number];
            const Homography& own = homographies_[photo];
            std::size_t count = 0;
            for (std::int32_t entry = first_[photo]; entry != END;) {
                const auto place = static_cast<std::size_t>(entry);
                const std::size_t region = place / SLOTS;
                std::size_t first = starts[region];
                while (first < starts[region + 1]) {
                    const std::size_t taken = std::min(starts[region + 1] - first, CHUNK - count);
                    load(map.pixels(), regions[region], place % SLOTS, first, taken, count);
                    first += taken;
                    count += taken;
                    if (count == CHUNK) {
                        blend_chunk<MAY_BE_HIDDEN>(field_.photos, photo, own, camera.focal(),
                                                   chunk_, count, image);
                        count = 0;
                    }
                }
                entry = next_[place];
            }
            if (count > 0) {
                blend_chunk<MAY_BE_HIDDEN>(field_.photos, photo, own, camera.focal(), chunk_, count,
                                           image);
            }
            first_[photo] = END;
        }
    }

    /// Puts pixels of a region into the chunk, and some more behind them.
    LFNAV_INLINE void load(const RegionPixels& pixels, const Region& region, std::size_t slot,
                           std::size_t first, std::size_t count, std::size_t place) {
        const float a = region.a[slot], b = region.b[slot], c = region.c[slot], d = region.d[slot];
        const float left = region.left, top = region.top;
        for (std::size_t start = 0; start < count; start += TOGETHER) {
            const std::size_t from = first + start, to = place + start;
#pragma omp simd
            for (std::size_t i = 0; i < TOGETHER; ++i) {
                const float x = pixels.x[from + i] - left, y = pixels.y[from + i] - top;
                chunk_.x[to + i] = pixels.x[from + i];
                chunk_.y[to + i] = pixels.y[from + i];
                chunk_.inverse_depth[to + i] = inverse_depth_[from + i];
                chunk_.weight[to + i] = a * x + c + (b + d * x) * y;
                chunk_.pixel[to + i] = pixels.place[from + i];
            }
        }
    }

    /// Has pixels that none of their region's photos shows shown by others.
    void fill_holes(const VirtualCamera& camera, float* image) {
        const auto found = filling_(field_.photos, blending_->candidates(), camera, homographies_,
                                    pixels_, seen_, image);
        // Neighbours mostly have the same photo.
        for (std::size_t first = 0, last = 0; first < found.size(); first = last) {
            const std::size_t photo = found[first].photo;
            std::size_t count = 0;
            for (; last < found.size() && found[last].photo == photo && count < CHUNK; ++last) {
                const std::size_t pixel = found[last].pixel;
                chunk_.x[count] = pixels_.x[pixel] - static_cast<float>(middle_.x);
                chunk_.y[count] = pixels_.y[pixel] - static_cast<float>(middle_.y);
                chunk_.inverse_depth[count] = seen_[pixel];
                chunk_.weight[count] = 1.0F;
                chunk_.pixel[count++] = static_cast<std::int32_t>(pixel);
            }
            blend_chunk<false>(field_.photos, photo, homographies_[photo], camera.focal(), chunk_,
                               count, image);
        }
        for (const HoleFilling::Found& one : found) {
            image[4 * one.pixel + 3] = 1.0F;
        }
    }

    LightField field_;
    VirtualViews views_;
    Middle middle_;
    std::unique_ptr<Surface> surface_;
    std::unique_ptr<Blending> blending_;
    Homographies homographies_;
    /// Photos that any region shows; the first region of each one's chain, and the next: entries
    /// are SLOTS times the region and the photo's slot in it.
    std::vector<std::size_t> shown_;
    std::vector<std::int32_t> first_, next_;
    /// The pixels in the order of the image, and the surface's inverse depths there.
    ImagePoints pixels_;
    std::vector<float> seen_;
    /// These in the order of the regions' pixels.
    std::vector<float> inverse_depth_;
    PixelChunk chunk_ = {};
    HoleFilling filling_;
};

/// Renders views.
///
/// @param images: (B, P, 4) receives colours, 0 to 255, and 1 where any photo shows the pixel; all
///     zero elsewhere.
/// @param inverse_depths: (B, P) receives the surface's, 1 / metres along the optical axis; 0:
/// none.
inline void render(const LightField& field, const VirtualViews& views, float* images,
                   float* inverse_depths) {
    ViewRenderer renderer(field, views);
    const std::size_t pixels = views.pixels.size();
    for (std::size_t number = 0; number < views.count; ++number) {
        renderer.draw(number, images + 4 * pixels * number);
        std::ranges::copy(renderer.inverse_depths(), inverse_depths + pixels * number);
    }
}

/// Renders and compares views.
///
/// @param costs: (B,) receives the costs.
inline void compare_views(const LightField& field, const VirtualViews& views,
                          const Comparison& comparison, double* costs) {
    ViewRenderer renderer(field, views);
    std::vector<float> image(4 * views.pixels.size());
    const MaskedImage rendered{image.data(), comparison.query.height, comparison.query.width};
    for (std::size_t number = 0; number < views.count; ++number) {
        renderer.draw(number, image.data());
        costs[number] = compare(rendered, comparison);
    }
}

}  // namespace lfnav::LFNAV_LEVEL
