// What can be observed of a match: names, types, shapes, and how the numbers are read.
#pragma once

#include <vector>

#include "match.hpp"

namespace fbrl {

constexpr int kMaxPlayers = MAX_PLAYERS;
// Fills positions, directions and roles of the players that a small-sided scenario lacks.
constexpr int kPadding = -1;

enum class Type { kBool, kInt8, kInt64, kFloat32 };

struct Field {
  const char *name;
  Type type;
  std::vector<int> shape;
  // Writes the numbers of the shape, side by side.
  void (*write)(const Match &match, void *out);
};

// All of them: the keys of fbrl's observations, and a step's reward, terminated and truncated.
const std::vector<Field> &fields();

}  // namespace fbrl
