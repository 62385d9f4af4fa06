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
#include "plane_views.hpp"
#include "ranking.hpp"

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
    /// @param most_ranked: more photos are narrowed down to the best at the outlook's points.
    Tiling(const Grid& grid, const PhotoIndex& index, std::size_t most_ranked)
        : grid_(grid),
          most_ranked_(most_ranked),
          all_rows_(index.count),
          bounds_(POINTS * index.groups),
          tiles_((grid.across.size() - 1) * (grid.down.size() - 1)) {
        for (std::size_t row = 0; row < index.count; ++row) {
            all_rows_[row] = static_cast<std::int32_t>(row);
        }
        for (std::size_t i = 0; i < POINTS; ++i) {
            const std::size_t side = grid.outlook_across.size();
            outlook_columns_[i] = static_cast<float>(grid.outlook_across[i % side]);
            outlook_rows_[i] = static_cast<float>(grid.outlook_down[i / side]);
        }
        for (const std::int64_t y : grid.down) {
            for (const std::int64_t x : grid.across) {
                columns_.push_back(static_cast<float>(x));
                rows_.push_back(static_cast<float>(y));
            }
        }
        // The last corner stands for those that are not there.
        const std::size_t filled = (columns_.size() + POINTS - 1) / POINTS * POINTS;
        columns_.resize(filled, columns_.back());
        rows_.resize(filled, rows_.back());
        photos_.resize(SHARING * filled);
        weights_.resize(SHARING * filled);
    }

    std::size_t across() const { return grid_.across.size() - 1; }
    const Grid& grid() const { return grid_; }
    std::span<const Tile> tiles() const { return tiles_; }

    /// Chooses the photos of all tiles for a virtual camera, and their weights.
    LFNAV_INLINE void choose(const VirtualCamera& camera, const PhotoIndex& index,
                             const PenaltySettings& settings) {
        SurfacePoints points;
        const std::int32_t* rows = all_rows_.data();
        std::size_t count = index.count;
        std::int32_t few_rows[POINTS];
        if (count > most_ranked_) {
            Outlook outlook;
            set_points(camera, index.origin, outlook_columns_, outlook_rows_, points);
            look_out(points, index, settings, bounds_.data(), outlook);
            rows = few_rows;
            count = distinct_rows(outlook, few_rows);
        }
        BestPhotos best;
        for (std::size_t first = 0; first < columns_.size(); first += POINTS) {
            set_points(camera, index.origin, columns_.data() + first, rows_.data() + first, points);
            rank_photos(points, index, rows, count, settings, best);
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
    std::size_t most_ranked_;
    std::vector<std::int32_t> all_rows_;
    std::vector<float> bounds_;
    std::vector<Tile> tiles_;
    float outlook_columns_[POINTS], outlook_rows_[POINTS];
    std::vector<float> columns_, rows_;
    std::vector<std::int32_t> photos_;
    std::vector<float> weights_;
};

}  // namespace lfnav::LFNAV_LEVEL
