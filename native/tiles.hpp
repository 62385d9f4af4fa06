// Tiles of the virtual image, whose photos are the best at their corners.

#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <span>
#include <vector>

#include "blending.hpp"
#include "candidate_views.hpp"
#include "level.hpp"
#include "light_field.hpp"
#include "ranking.hpp"
#include "regions.hpp"
#include "surface.hpp"
#include "virtual_views.hpp"

namespace lfnav::LFNAV_LEVEL {

/// The tiles of virtual images of one size; made once for many of them.
class Tiling final : public Blending {
  public:
    Tiling(const LightField& field, const VirtualViews& views, const Middle& middle,
           const Surface& surface)
        : field_(field),
          grid_(views.grid),
          all_rows_(field.index.count),
          bounds_(POINTS * field.index.groups),
          map_(views.width, views.height, views.pixels, middle),
          probes_(POINTS),
          corners_((grid_.across.size() * grid_.down.size() + POINTS - 1) / POINTS * POINTS),
          inverse_depths_(corners_.count()),
          photos_(SHARING * corners_.count()),
          weights_(SHARING * corners_.count()) {
        std::iota(all_rows_.begin(), all_rows_.end(), 0);
        probes_.set_crossings(grid_.probes_across, grid_.probes_down);
        corners_.set_crossings(grid_.across, grid_.down);
        surface.prepare(probes_);
        surface.prepare(corners_);
        for (std::size_t row = 0; row + 1 < grid_.down.size(); ++row) {
            for (std::size_t column = 0; column < across(); ++column) {
                map_.add(index(grid_.across[column]), index(grid_.down[row]));
            }
        }
        add_pixels(views.width, views.height);
    }

    const RegionMap& map() const override { return map_; }
    const bool* candidates() const override { return field_.photos.usable; }

    void choose(const VirtualCamera& camera, const Surface& surface, Homographies&) override {
        const PhotoIndex& index = field_.index;
        const PenaltySettings& settings = field_.penalties;
        SurfacePoints points;
        const std::int32_t* rows = all_rows_.data();
        std::size_t count = index.count;
        std::int32_t few_rows[POINTS];
        if (count > field_.most_ranked) {
            float inverse_depths[POINTS];
            CandidateViews best;
            surface.set_inverse_depths(probes_, inverse_depths);
            set_points(camera, index.origin, probes_.x.data(), probes_.y.data(), inverse_depths,
                       points);
            find_candidates(points, field_.photos, index, settings, bounds_.data(), best);
            rows = few_rows;
            count = distinct_rows(best, few_rows);
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
                join_corners(row, column, map_.regions()[row * across() + column]);
            }
        }
    }

  private:
    static std::size_t index(std::int64_t i) { return static_cast<std::size_t>(i); }
    std::size_t across() const { return grid_.across.size() - 1; }

    /// Tiles reach from their corner up to the next one; the outer ones, to the image's border.
    void add_pixels(std::size_t width, std::size_t height) {
        for (std::size_t y = 0, row = 0; y < height; ++y) {
            while (row + 2 < grid_.down.size() && index(grid_.down[row + 1]) <= y) {
                ++row;
            }
            for (std::size_t column = 0; column < across(); ++column) {
                const std::size_t first = column > 0 ? index(grid_.across[column]) : 0;
                const std::size_t end =
                    column + 1 < across() ? index(grid_.across[column + 1]) : width;
                map_.add_run(static_cast<std::int32_t>(row * across() + column),
                             map_.before(y, first), map_.before(y, end));
            }
        }
        map_.sort_pixels();
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
    RegionMap map_;
    /// More photos than are ranked are narrowed down to the best at the probes.
    ImagePoints probes_, corners_;
    std::vector<float> inverse_depths_;
    std::vector<std::int32_t> photos_;
    std::vector<float> weights_;
};

}  // namespace lfnav::LFNAV_LEVEL
