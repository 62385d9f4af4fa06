// Tiles of the virtual image, whose photos are the best at their corners.

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
#include "regions.hpp"
#include "surface.hpp"
#include "virtual_views.hpp"

namespace lfnav::LFNAV_LEVEL {

/// The tiles of virtual images of one size; made once for many of them.
class Tiling {
  public:
    Tiling(const LightField& field, const VirtualViews& views, const Middle& middle,
           const Surface& surface)
        : field_(field),
          grid_(views.grid),
          all_rows_(field.index.count),
          bounds_(POINTS * field.index.groups),
          tiles_((grid_.across.size() - 1) * (grid_.down.size() - 1)),
          pixels_(views.pixels.size()),
          outlook_(POINTS),
          corners_((grid_.across.size() * grid_.down.size() + POINTS - 1) / POINTS * POINTS),
          inverse_depths_(corners_.count()),
          photos_(SHARING * corners_.count()),
          weights_(SHARING * corners_.count()) {
        for (std::size_t row = 0; row < all_rows_.size(); ++row) {
            all_rows_[row] = static_cast<std::int32_t>(row);
        }
        outlook_.set_crossings(grid_.outlook_across, grid_.outlook_down);
        corners_.set_crossings(grid_.across, grid_.down);
        surface.prepare(outlook_);
        surface.prepare(corners_);
        order_pixels(views, middle);
    }

    std::span<const Region> regions() const { return tiles_; }
    const RegionPixels& pixels() const { return pixels_; }
    /// (N,) photos that may show what those of a tile do not.
    const bool* candidates() const { return field_.photos.usable; }

    /// Chooses the photos of all tiles for a virtual camera, and their weights.
    ///
    /// @param surface: as it sees it.
    template <typename HomographyOf>
    void choose(const VirtualCamera& camera, const Surface& surface, HomographyOf) {
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
    std::size_t across() const { return grid_.across.size() - 1; }

    /// Sorts the pixels by the tiles that they are in, and sets where these begin.
    void order_pixels(const VirtualViews& views, const Middle& middle) {
        for (std::size_t i = 0; i < tiles_.size(); ++i) {
            tiles_[i].left = static_cast<float>(grid_.across[i % across()] - middle.x);
            tiles_[i].top = static_cast<float>(grid_.down[i / across()] - middle.y);
        }
        // In which tile each column, or row, is.
        const auto tiles_along = [](std::span<const std::int64_t> borders, std::size_t length) {
            std::vector<std::size_t> result(length);
            for (std::size_t i = 0, tile = 0; i < length; result[i++] = tile) {
                while (tile + 2 < borders.size() &&
                       borders[tile + 1] <= static_cast<std::int64_t>(i)) {
                    ++tile;
                }
            }
            return result;
        };
        const auto columns = tiles_along(grid_.across, views.width);
        const auto rows = tiles_along(grid_.down, views.height);
        std::vector<std::size_t> tiles(views.pixels.size());
        pixels_.starts.resize(tiles_.size() + 1);
        const auto width = static_cast<std::uint32_t>(views.width);
        const auto column = [&](std::size_t i) {
            return static_cast<std::uint32_t>(views.pixels[i]) % width;
        };
        const auto row = [&](std::size_t i) {
            return static_cast<std::uint32_t>(views.pixels[i]) / width;
        };
        for (std::size_t i = 0; i < tiles.size(); ++i) {
            tiles[i] = rows[row(i)] * across() + columns[column(i)];
            ++pixels_.starts[tiles[i] + 1];
        }
        for (std::size_t tile = 0; tile < tiles_.size(); ++tile) {
            pixels_.starts[tile + 1] += pixels_.starts[tile];
        }
        std::vector<std::size_t> ends(pixels_.starts.begin(), pixels_.starts.end() - 1);
        for (std::size_t i = 0; i < tiles.size(); ++i) {
            const std::size_t place = ends[tiles[i]]++;
            pixels_.x[place] = static_cast<float>(static_cast<std::int32_t>(column(i)) - middle.x);
            pixels_.y[place] = static_cast<float>(static_cast<std::int32_t>(row(i)) - middle.y);
            pixels_.place[place] = static_cast<std::int32_t>(i);
        }
    }

    /// Sets a tile from the photos of its corners.
    LFNAV_INLINE void join_corners(std::size_t row, std::size_t column, Region& tile) const {
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

    LightField field_;
    Grid grid_;
    std::vector<std::int32_t> all_rows_;
    std::vector<float> bounds_;
    std::vector<Region> tiles_;
    RegionPixels pixels_;
    /// More photos than are ranked are narrowed down to the best at the outlook's points.
    Places outlook_, corners_;
    std::vector<float> inverse_depths_;
    std::vector<std::int32_t> photos_;
    std::vector<float> weights_;
};

}  // namespace lfnav::LFNAV_LEVEL
