#include "renderer.hpp"

#include <algorithm>
#include <memory>
#include <vector>

#include "comparison.hpp"
#include "depth_surface.hpp"
#include "hole_filling.hpp"
#include "homography.hpp"
#include "level.hpp"
#include "sampling.hpp"
#include "surface.hpp"
#include "tiles.hpp"

namespace lfnav::LFNAV_LEVEL {

namespace {

constexpr std::size_t SLOTS = 16;
constexpr std::int32_t END = -1;
static_assert(MOST_BLENDED < SLOTS);

/// Where numbers may be read or written so many beyond the last one.
template <typename Number>
std::vector<Number> with_margin(std::size_t count) {
    return std::vector<Number>(count + TOGETHER);
}

/// Renders one virtual view after the other; what it needs for that it makes once.
class ViewRenderer {
  public:
    ViewRenderer(const LightField& field, const VirtualViews& views)
        : field_(field),
          views_(views),
          surface_(surface_of(field, views)),
          tiling_(views.grid, field, *surface_),
          middle_{static_cast<std::int32_t>(views.width / 2),
                  static_cast<std::int32_t>(views.height / 2)},
          homographies_(field.photos.count),
          is_mapped_(field.photos.count),
          shown_(field.photos.count),
          first_(field.photos.count, END),
          next_(SLOTS * tiling_.tiles().size()),
          pixels_(views.pixels.size()),
          places_(pixels_.size()),
          seen_(pixels_.size()),
          starts_(tiling_.tiles().size() + 1),
          x_(with_margin<float>(pixels_.size())),
          y_(with_margin<float>(pixels_.size())),
          tile_x_(with_margin<float>(pixels_.size())),
          tile_y_(with_margin<float>(pixels_.size())),
          inverse_depth_(with_margin<float>(pixels_.size())),
          place_(with_margin<std::int32_t>(pixels_.size())) {
        order_pixels();
        surface_->prepare(places_);
    }

    /// Renders a view.
    ///
    /// @param image: (P, 4) receives it, see render().
    LFNAV_INLINE void draw(std::size_t number, float* image) {
        const VirtualCamera camera(views_.poses + 16 * number, views_.intrinsics);
        surface_->look_from(camera, number);
        tiling_.choose(camera, *surface_);
        surface_->set_inverse_depths(places_, seen_.data());
        for (std::size_t i = 0; i < pixels_.size(); ++i) {
            inverse_depth_[i] = seen_[static_cast<std::size_t>(place_[i])];
        }
        std::fill(is_mapped_.begin(), is_mapped_.end(), std::uint8_t{0});
        std::fill_n(image, 4 * pixels_.size(), 0.0F);
        if (field_.photos.has_depth) {
            blend_tiles<true>(camera, image);
        } else {
            blend_tiles<false>(camera, image);
        }
        if (normalise(image) > 0) {
            for (std::size_t i = 0; i < pixels_.size(); ++i) {
                pixels_[i].inverse_depth = seen_[i];
            }
            fill_holes(camera, image);
        }
    }

    /// The inverse depths at the pixels of the view that was drawn last.
    std::span<const float> inverse_depths() const { return {seen_.data(), pixels_.size()}; }

  private:
    static std::unique_ptr<Surface> surface_of(const LightField& field, const VirtualViews& views) {
        if (views.samples == nullptr) {
            return std::make_unique<PlaneSurface>(field.plane);
        }
        return std::make_unique<DepthSurface>(field, views);
    }

    /// Sets the pixels, and sorts them by the tiles that they are in.
    void order_pixels() {
        const Grid& grid = tiling_.grid();
        const auto tile_at = [](std::span<const std::int64_t> borders, std::int64_t place) {
            const auto inner_end = borders.end() - 1;
            const auto after = std::upper_bound(borders.begin() + 1, inner_end, place);
            return static_cast<std::size_t>(after - borders.begin()) - 1;
        };
        std::vector<std::size_t> tiles(pixels_.size());
        const auto width = static_cast<std::int64_t>(views_.width);
        for (std::size_t i = 0; i < pixels_.size(); ++i) {
            const std::int64_t column = views_.pixels[i] % width, row = views_.pixels[i] / width;
            pixels_[i] = {static_cast<float>(column), static_cast<float>(row), 0.0F};
            tiles[i] = tile_at(grid.down, row) * tiling_.across() + tile_at(grid.across, column);
            ++starts_[tiles[i] + 1];
        }
        for (std::size_t tile = 0; tile + 1 < starts_.size(); ++tile) {
            starts_[tile + 1] += starts_[tile];
        }
        std::vector<std::size_t> ends(starts_.begin(), starts_.end() - 1);
        for (std::size_t i = 0; i < pixels_.size(); ++i) {
            const std::size_t tile = tiles[i], place = ends[tile]++;
            const std::int64_t column = views_.pixels[i] % width, row = views_.pixels[i] / width;
            places_.x[i] = static_cast<float>(column);
            places_.y[i] = static_cast<float>(row);
            x_[place] = static_cast<float>(column - middle_.x);
            y_[place] = static_cast<float>(row - middle_.y);
            tile_x_[place] = static_cast<float>(column - grid.across[tile % tiling_.across()]);
            tile_y_[place] = static_cast<float>(row - grid.down[tile / tiling_.across()]);
            place_[place] = static_cast<std::int32_t>(i);
        }
    }

    LFNAV_INLINE const Homography& homography(const VirtualCamera& camera, std::size_t photo) {
        if (is_mapped_[photo] == 0) {
            homographies_[photo].set(field_.photos, photo, camera, middle_);
            is_mapped_[photo] = 1;
        }
        return homographies_[photo];
    }

    /// Chains the tiles that show the same photo; returns how many photos any tile shows.
    LFNAV_INLINE std::size_t chain_tiles() {
        const std::span<const Tile> tiles = tiling_.tiles();
        std::size_t count = 0;
        // From the last to the first, so that each chain runs from the first to the last.
        for (std::size_t number = tiles.size(); number-- > 0;) {
            if (starts_[number] == starts_[number + 1]) {
                continue;
            }
            const Tile& tile = tiles[number];
            for (std::size_t slot = 0; slot < tile.count; ++slot) {
                const auto photo = static_cast<std::size_t>(tile.photo[slot]);
                if (first_[photo] == END) {
                    shown_[count++] = photo;
                }
                const std::size_t entry = SLOTS * number + slot;
                next_[entry] = first_[photo];
                first_[photo] = static_cast<std::int32_t>(entry);
            }
        }
        return count;
    }

    /// Adds to each pixel what the photos of its tile show, photo by photo.
    ///
    /// @tparam MAY_BE_HIDDEN: whether depth maps may hide the surface.
    template <bool MAY_BE_HIDDEN>
    LFNAV_INLINE void blend_tiles(const VirtualCamera& camera, float* image) {
        const std::span<const Tile> tiles = tiling_.tiles();
        const std::size_t shown = chain_tiles();
        for (std::size_t number = 0; number < shown; ++number) {
            const std::size_t photo = shown_[number];
            const Homography& own = homography(camera, photo);
            std::size_t count = 0;
            for (std::int32_t entry = first_[photo]; entry != END;) {
                const auto place = static_cast<std::size_t>(entry);
                const std::size_t tile = place / SLOTS;
                std::size_t first = starts_[tile];
                while (first < starts_[tile + 1]) {
                    const std::size_t taken = std::min(starts_[tile + 1] - first, CHUNK - count);
                    load(tiles[tile], place % SLOTS, first, taken, count);
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

    /// Puts pixels of a tile into the chunk, and some more behind them.
    LFNAV_INLINE void load(const Tile& tile, std::size_t slot, std::size_t first, std::size_t count,
                           std::size_t place) {
        const float a = tile.a[slot], b = tile.b[slot], c = tile.c[slot], d = tile.d[slot];
        for (std::size_t start = 0; start < count; start += TOGETHER) {
            const std::size_t from = first + start, to = place + start;
#pragma omp simd
            for (std::size_t i = 0; i < TOGETHER; ++i) {
                const float x = tile_x_[from + i], y = tile_y_[from + i];
                chunk_.x[to + i] = x_[from + i];
                chunk_.y[to + i] = y_[from + i];
                chunk_.inverse_depth[to + i] = inverse_depth_[from + i];
                chunk_.weight[to + i] = a * x + c + (b + d * x) * y;
                chunk_.pixel[to + i] = place_[from + i];
            }
        }
    }

    /// Divides colours by their weights; alpha becomes 1 or, where no photo shows anything, 0.
    ///
    /// @return how many pixels no photo shows.
    LFNAV_INLINE std::size_t normalise(float* image) const {
        const float smallest = field_.smallest_weight;
        std::int32_t empty = 0;
#pragma omp simd reduction(+ : empty)
        for (std::size_t i = 0; i < pixels_.size(); ++i) {
            const float total = image[4 * i + 3] / 255.0F;
            const bool is_shown = total > smallest;
            const float factor = is_shown ? 1.0F / total : 0.0F;
            image[4 * i] *= factor;
            image[4 * i + 1] *= factor;
            image[4 * i + 2] *= factor;
            image[4 * i + 3] = is_shown ? 1.0F : 0.0F;
            empty += is_shown ? 0 : 1;
        }
        return static_cast<std::size_t>(empty);
    }

    /// Has pixels that none of their tile's photos shows shown by others.
    void fill_holes(const VirtualCamera& camera, float* image) {
        const auto own = [&](std::size_t photo) -> const Homography& {
            return homography(camera, photo);
        };
        const auto found = filling_(field_.photos, camera, own, pixels_, image);
        // Neighbours mostly have the same photo.
        for (std::size_t first = 0, last = 0; first < found.size(); first = last) {
            const std::size_t photo = found[first].photo;
            std::size_t count = 0;
            for (; last < found.size() && found[last].photo == photo && count < CHUNK; ++last) {
                const RenderedPixel& pixel = pixels_[found[last].pixel];
                chunk_.x[count] = pixel.x - static_cast<float>(middle_.x);
                chunk_.y[count] = pixel.y - static_cast<float>(middle_.y);
                chunk_.inverse_depth[count] = pixel.inverse_depth;
                chunk_.weight[count] = 1.0F;
                chunk_.pixel[count++] = static_cast<std::int32_t>(found[last].pixel);
            }
            blend_chunk<false>(field_.photos, photo, own(photo), camera.focal(), chunk_, count,
                               image);
        }
        for (const HoleFilling::Found& one : found) {
            image[4 * one.pixel + 3] = 1.0F;
        }
    }

    LightField field_;
    VirtualViews views_;
    std::unique_ptr<Surface> surface_;
    Tiling tiling_;
    Middle middle_;
    std::vector<Homography> homographies_;
    std::vector<std::uint8_t> is_mapped_;
    /// Photos that any tile shows; the first tile of each one's chain, and the next: entries are
    /// SLOTS times the tile and the photo's slot in it.
    std::vector<std::size_t> shown_;
    std::vector<std::int32_t> first_, next_;
    /// In the order of the image.
    std::vector<RenderedPixel> pixels_;
    Places places_;
    std::vector<float> seen_;
    /// Tile by tile: where a tile's pixels begin, where they are in the image, from the tile's
    /// corner, and which they are in the order of the image.
    std::vector<std::size_t> starts_;
    std::vector<float> x_, y_, tile_x_, tile_y_, inverse_depth_;
    std::vector<std::int32_t> place_;
    PixelChunk chunk_ = {};
    HoleFilling filling_;
};

}  // namespace

void render(const LightField& field, const VirtualViews& views, float* images,
            float* inverse_depths) {
    ViewRenderer renderer(field, views);
    const std::size_t pixels = views.pixels.size();
    for (std::size_t number = 0; number < views.count; ++number) {
        renderer.draw(number, images + 4 * pixels * number);
        std::ranges::copy(renderer.inverse_depths(), inverse_depths + pixels * number);
    }
}

void compare_views(const LightField& field, const VirtualViews& views, const Comparison& comparison,
                   double* costs) {
    ViewRenderer renderer(field, views);
    std::vector<float> image(4 * views.pixels.size());
    const MaskedImage rendered{image.data(), comparison.query.height, comparison.query.width};
    for (std::size_t number = 0; number < views.count; ++number) {
        renderer.draw(number, image.data());
        costs[number] = compare(comparison.cost, rendered, comparison.query, comparison.fit_gain,
                                comparison.settings);
    }
}

}  // namespace lfnav::LFNAV_LEVEL
