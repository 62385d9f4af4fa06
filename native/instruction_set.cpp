#include "instruction_set.hpp"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdlib>
#include <stdexcept>
#include <string>

namespace lfnav {

namespace {

constexpr const char* VARIABLE = "LFNAV_INSTRUCTION_SET";
/// In the order of InstructionSet.
constexpr std::array<std::string_view, 3> NAMES{"baseline", "x86-64-v3", "x86-64-v4"};

InstructionSet of_processor() {
#ifdef LFNAV_SEVERAL_LEVELS
    __builtin_cpu_init();
#if defined(__clang__) && __clang_major__ < 18
    // These know no levels, only features: those by which processors of a level are told.
    const bool is_v3 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
                       __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2");
    const bool is_v4 = is_v3 && __builtin_cpu_supports("avx512f") &&
                       __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd") &&
                       __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
#else
    const bool is_v3 = __builtin_cpu_supports("x86-64-v3");
    const bool is_v4 = __builtin_cpu_supports("x86-64-v4");
#endif
    if (is_v4) {
        return InstructionSet::X86_64_V4;
    }
    if (is_v3) {
        return InstructionSet::X86_64_V3;
    }
#endif
    return InstructionSet::BASELINE;
}

InstructionSet chosen() {
    const InstructionSet best = of_processor();
    const char* const wanted = std::getenv(VARIABLE);
    if (wanted == nullptr) {
        return best;
    }
    for (std::size_t level = 0; level < NAMES.size(); ++level) {
        if (NAMES[level] == wanted) {
            return std::min(static_cast<InstructionSet>(level), best);
        }
    }
    throw std::invalid_argument(std::string(VARIABLE) + " is '" + wanted +
                                "'; choose baseline, x86-64-v3 or x86-64-v4");
}

}  // namespace

InstructionSet instruction_set() {
    static const InstructionSet level = chosen();
    return level;
}

std::string_view name_of(InstructionSet level) { return NAMES[static_cast<std::size_t>(level)]; }

}  // namespace lfnav
