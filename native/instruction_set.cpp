#include "instruction_set.hpp"

namespace lfnav {

std::string_view instruction_set() {
#if defined(__x86_64__) && defined(__linux__) && defined(__GNUC__) && !defined(LFNAV_ONE_LEVEL)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("x86-64-v4")) {
        return "x86-64-v4";
    }
    if (__builtin_cpu_supports("x86-64-v3")) {
        return "x86-64-v3";
    }
#endif
    return "baseline";
}

}  // namespace lfnav
