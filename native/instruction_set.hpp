// Kernels compiled for several levels of x86-64, of which each processor runs the best it can.
//
// One build then runs everywhere and uses AVX-512 where it is there. Work is an object whose call
// operator is compiled once for each level and told how many bytes a register holds:
//
//     struct Sum {
//         std::span<const float> numbers;
//         template <std::size_t BYTES> LFNAV_INLINE float operator()() const { ... }
//     };
//     const float sum = at_best_level(Sum{numbers});
//
// What such an operator calls has to be LFNAV_INLINE too, or it is compiled for the lowest level.

#pragma once

#include <cstddef>
#include <string_view>

#define LFNAV_INLINE inline __attribute__((always_inline))

namespace lfnav {

/// Levels that kernels are compiled for; what another architecture has is its baseline.
enum class InstructionSet { BASELINE, X86_64_V3, X86_64_V4 };

/// The best that this processor can run, or the one that LFNAV_INSTRUCTION_SET names, if lower.
///
/// @throws std::invalid_argument if that is none, each time.
InstructionSet instruction_set();

std::string_view name_of(InstructionSet level);

#if defined(__x86_64__) && defined(__GNUC__)

template <typename Work>
__attribute__((target("arch=x86-64-v4"))) auto at_x86_64_v4(const Work& work) {
    return work.template operator()<64>();
}

template <typename Work>
__attribute__((target("arch=x86-64-v3"))) auto at_x86_64_v3(const Work& work) {
    return work.template operator()<32>();
}

/// Calls work.template operator()<BYTES>(), compiled for the best level.
template <typename Work>
auto at_best_level(const Work& work) {
    switch (instruction_set()) {
        case InstructionSet::X86_64_V4:
            return at_x86_64_v4(work);
        case InstructionSet::X86_64_V3:
            return at_x86_64_v3(work);
        default:
            return work.template operator()<16>();
    }
}

#else

template <typename Work>
auto at_best_level(const Work& work) {
    return work.template operator()<16>();
}

#endif

}  // namespace lfnav
