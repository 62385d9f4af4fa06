// Which level of x86-64 this processor has, of those that kernels are compiled for.
//
// One build runs everywhere and uses AVX-512 where it is there: CMakeLists.txt compiles the files
// with kernels once for each level, and each time everything in them is in a namespace of that name
// (level.hpp). LFNAV_DECLARE declares a function of them at all levels, and LFNAV_BEST is that of
// the best level: LFNAV_BEST(robust_error)(view, target, photometry).

#pragma once

#include <string_view>

namespace lfnav {

/// Levels that kernels are compiled for; what another architecture has is its baseline.
enum class InstructionSet { BASELINE, X86_64_V3, X86_64_V4 };

/// The best that this processor can run, or the one that LFNAV_INSTRUCTION_SET names, if lower.
///
/// @throws std::invalid_argument if that is none, each time.
InstructionSet instruction_set();

std::string_view name_of(InstructionSet level);

template <typename Function>
Function* at_best_level(Function* baseline, Function* x86_64_v3, Function* x86_64_v4) {
    switch (instruction_set()) {
        case InstructionSet::X86_64_V4:
            return x86_64_v4;
        case InstructionSet::X86_64_V3:
            return x86_64_v3;
        default:
            return baseline;
    }
}

}  // namespace lfnav

#ifdef LFNAV_SEVERAL_LEVELS
#define LFNAV_DECLARE(...) \
    namespace baseline {   \
    __VA_ARGS__;           \
    }                      \
    namespace x86_64_v3 {  \
    __VA_ARGS__;           \
    }                      \
    namespace x86_64_v4 {  \
    __VA_ARGS__;           \
    }
#define LFNAV_BEST(function) \
    (*at_best_level(&baseline::function, &x86_64_v3::function, &x86_64_v4::function))
#else
#define LFNAV_DECLARE(...) \
    namespace baseline {   \
    __VA_ARGS__;           \
    }
#define LFNAV_BEST(function) baseline::function
#endif
