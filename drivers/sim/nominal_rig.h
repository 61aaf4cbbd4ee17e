#pragma once

#include <string_view>

namespace omnihdr::sim {

// The text of config/rigs/ladybug2.toml, as the program was built with it.
std::string_view NominalRigText();

}  // namespace omnihdr::sim
