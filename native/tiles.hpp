// Tiles of the virtual image, each with some photos and weights that are bilinear in the pixel.

#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "level.hpp"
#include "light_field.hpp"
#include "outlook.hpp"
#include "ranking.hpp"
#include "surface.hpp"
#include "virtual_views.hpp"

namespace lfnav::LFNAV_LEVEL {

/// Photos that are blended in a tile: those of its four corners.
constexpr std::size_t MOST_BLENDED = 4 * SHARING;

/// A tile's photos and the weights a x + b y + c + d x y of each, from its upper left corner.
struct Tile {
    std::size_t count;
    std::int32_t photo[MOST_BLENDED];
    float a[MOST_BLENDED], b[MOST_BLENDED], c[MOST_BLENDED], d[MOST_BLENDED];
};

/// The tiles of virtual images of one size; made once for many of them.
class Tiling {
  public:
    Tiling(const Grid& grid, const LightField& field, const Surface& surface)
        : grid_(grid),
          field_(field),
          all_rows_(field.index.count),
          bounds_(POINTS * field.index.groups),
          tiles_((grid.across.size() - 1) * (grid.down.size() - 1)),
          outlook_(POINTS),
          corners_((grid.across.size() * grid.down.size() + POINTS - 1) / POINTS * POINTS),
          inverse_depths_(corners_.count()),
          photos_(SHARING * corners_.count()),
          weights_(SHARING * corners_.count()) {
        for (std::size_t row = 0; row < all_rows_.size(); ++row) {
            all_rows_[row] = static_cast<std::int32_t>(row);
        }
        for (std::size_t i = 0; i < POINTS; ++i) {
            const std::size_t side = grid.outlook_across.size();
            outlook_.x[i] = static_cast<float>(grid.outlook_across[i % side]);
            outlook_.y[i] = static_cast<float>(grid.outlook_down[i / side]);
        }
        const std::size_t corners = grid.across.size() * grid.down.size();
        for (std::size_t i = 0; i < corners_.count(); ++i) {
            // The last corner stands for those that are not there.
            const std::size_t corner = std::min(i, corners - 1);
            corners_.x[i] = static_cast<float>(grid.across[corner % grid.across.size()]);
            corners_.y[i] = static_cast<float>(grid.down[corner / grid.across.size()]);
        }
        surface.prepare(outlook_);
        surface.prepare(corners_);
    }

    std::size_t across() const { return grid_.across.size() - 1; }
    const Grid& grid() const { return grid_; }
    std::span<const Tile> tiles() const { return tiles_; }

    /// Chooses the photos of all tiles for a virtual camera, and their weights.
    ///
    /// @param surface: as it sees it.
    LFNAV_INLINE void choose(const VirtualCamera& camera, const Surface& surface) {
        const PhotoIndex& index = field_.index;
        const PenaltySettings& settings = field_.penalties;
        SurfacePoints points;
        const std::int32_t* rows = all_rows_.data();
        std::size_t count = index.count;
        std::int32_t few_rows[POINTS];
        if (count > field_.most_ranked) {
            float inverse_depths[POINTS];
            Outlook outlook;
            surface.set_inverse_depths(outlook_, inverse_depths);
            set_points(camera, index.origin, outlook_.x.data(), outlook_.y.data(), inverse_depths,
                       points);
            look_out(points, field_.photos, index, settings, bounds_.data(), outlook);
            rows = few_rows;
            count = distinct_rows(outlook, few_rows);
        }
        surface.set_inverse_depths(corners_, inverse_depths_.data());
        BestPhotos best;
        for (std::size_t first = 0; first < corners_.count(); first += POINTS) {
            set_points(camera, index.origin, corners_.x.data() + first, corners_.y.data() + first,
                       inverse_depths_.data() + first, points);
            if (field_.photos.has_depth) {
                rank_photos<true>(points, field_.photos, index, rows, count, settings, best);
            } else {
                rank_photos<false>(points, field_.photos, index, rows, count, settings, best);
            }
            set_shares(best, settings, weights_.data() + SHARING * first);
            std::copy_n(&best.photo[0][0], SHARING * POINTS, photos_.data() + SHARING * first);
        }
        for (std::size_t row = 0; row + 1 < grid_.down.size(); ++row) {
            for (std::size_t column = 0; column < across(); ++column) {
                join_corners(row, column, tiles_[row * across() + column]);
            }
        }
    }

  private:
    /// Sets a tile from the photos of its corners.
    LFNAV_INLINE void join_corners(std::size_t row, std::size_t column, Tile& tile) const {
        const std::size_t corners = grid_.across.size();
        float at_corner[4][MOST_BLENDED + 1] = {};
        std::size_t count = 0;
        for (std::size_t number = 0; number < 4; ++number) {
            const std::size_t corner = (row + number / 2) * corners + column + number % 2;
            const std::size_t first = corner / POINTS * (SHARING * POINTS) + corner % POINTS;
            for (std::size_t rank = 0; rank < SHARING; ++rank) {
                const std::int32_t photo = photos_[first + rank * POINTS];
                if (photo < 0) {
                    break;
                }
                std::size_t slot = 0;
                while (slot < count && tile.photo[slot] != photo) {
                    ++slot;
                }
                tile.photo[slot] = photo;
                count = std::max(count, slot + 1);
                at_corner[number][slot] = weights_[first + rank * POINTS];
            }
        }
        tile.count = count;
        const auto length = [](std::span<const std::int64_t> borders, std::size_t i) {
            return static_cast<float>(std::max<std::int64_t>(borders[i + 1] - borders[i], 1));
        };
        const float step_x = 1.0F / length(grid_.across, column);
        const float step_y = 1.0F / length(grid_.down, row);
        // a (1-s)(1-t) + b s (1-t) + c (1-s) t + d s t with s = x / width, t = y / height.
        for (std::size_t slot = 0; slot < MOST_BLENDED; ++slot) {
            const float a = at_corner[0][slot], b = at_corner[1][slot];
            const float c = at_corner[2][slot], d = at_corner[3][slot];
            tile.a[slot] = (b - a) * step_x;
            tile.b[slot] = (c - a) * step_y;
            tile.c[slot] = a;
            tile.d[slot] = (a - b - c + d) * step_x * step_y;
        }
    }

    Grid grid_;
    LightField field_;
    std::vector<std::int32_t> all_rows_;
    std::vector<float> bounds_;
    std::vector<Tile> tiles_;
    /// More photos than are ranked are narrowed down to the best at the outlook's points.
    Places outlook_, corners_;
    std::vector<float> inverse_depths_;
    std::vector<std::int32_t> photos_;
    std::vector<float> weights_;
};

}  // namespace lfnav::LFNAV_LEVEL
