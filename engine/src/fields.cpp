#include "fields.hpp"

#include <cstdint>

namespace fbrl {
namespace {

using Team = std::vector<PlayerInfo> SharedInfo::*;
using Vector = Position SharedInfo::*;

template <Vector vector>
void write_vector(const Match &match, void *out) {
  const Position &position = match.info().*vector;
  for (int i = 0; i < 3; i++) static_cast<float *>(out)[i] = position.env_coord(i);
}

template <Team team, Position PlayerInfo::*vector>
void write_planar(const Match &match, void *out) {
  float *numbers = static_cast<float *>(out);
  for (const PlayerInfo &player : match.info().*team) {
    *numbers++ = (player.*vector).env_coord(0);
    *numbers++ = (player.*vector).env_coord(1);
  }
  float *const end = static_cast<float *>(out) + 2 * kMaxPlayers;
  while (numbers < end) *numbers++ = kPadding;
}

template <Team team, auto member, class Number, int padding>
void write_each(const Match &match, void *out) {
  Number *numbers = static_cast<Number *>(out);
  for (const PlayerInfo &player : match.info().*team) *numbers++ = static_cast<Number>(player.*member);
  Number *const end = static_cast<Number *>(out) + kMaxPlayers;
  while (numbers < end) *numbers++ = padding;
}

template <auto member>
void write_number(const Match &match, void *out) {
  *static_cast<std::int64_t *>(out) = match.info().*member;
}

std::int64_t designated(const SharedInfo &info) {
  for (std::size_t i = 0; i < info.left_team.size(); i++) {
    if (info.left_team[i].designated_player) return static_cast<std::int64_t>(i);
  }
  return -1;
}

template <Team team>
void add_team(std::vector<Field> &fields, const char *const (&names)[6]) {
  fields.push_back({names[0], Type::kFloat32, {kMaxPlayers, 2},
                    write_planar<team, &PlayerInfo::player_position>});
  fields.push_back({names[1], Type::kFloat32, {kMaxPlayers, 2},
                    write_planar<team, &PlayerInfo::player_direction>});
  fields.push_back({names[2], Type::kFloat32, {kMaxPlayers},
                    write_each<team, &PlayerInfo::tired_factor, float, 0>});
  fields.push_back({names[3], Type::kInt8, {kMaxPlayers},
                    write_each<team, &PlayerInfo::has_card, std::int8_t, 0>});
  fields.push_back({names[4], Type::kInt8, {kMaxPlayers},
                    write_each<team, &PlayerInfo::is_active, std::int8_t, 0>});
  fields.push_back({names[5], Type::kInt64, {kMaxPlayers},
                    write_each<team, &PlayerInfo::role, std::int64_t, kPadding>});
}

std::vector<Field> make_fields() {
  std::vector<Field> fields = {
      {"ball", Type::kFloat32, {3}, write_vector<&SharedInfo::ball_position>},
      {"ball_direction", Type::kFloat32, {3}, write_vector<&SharedInfo::ball_direction>},
      {"ball_rotation", Type::kFloat32, {3}, write_vector<&SharedInfo::ball_rotation>},
      {"active", Type::kInt64, {}, [](const Match &match, void *out) {
         *static_cast<std::int64_t *>(out) = match.info().left_controllers[0].controlled_player;
       }},
      {"designated", Type::kInt64, {}, [](const Match &match, void *out) {
         *static_cast<std::int64_t *>(out) = designated(match.info());
       }},
      {"ball_owned_team", Type::kInt64, {}, write_number<&SharedInfo::ball_owned_team>},
      {"ball_owned_player", Type::kInt64, {}, write_number<&SharedInfo::ball_owned_player>},
      {"game_mode", Type::kInt64, {}, write_number<&SharedInfo::game_mode>},
      {"score", Type::kInt64, {2}, [](const Match &match, void *out) {
         static_cast<std::int64_t *>(out)[0] = match.info().left_goals;
         static_cast<std::int64_t *>(out)[1] = match.info().right_goals;
       }},
      {"steps_left", Type::kInt64, {}, [](const Match &match, void *out) {
         *static_cast<std::int64_t *>(out) = match.steps_left();
       }},
      {"sticky_actions", Type::kInt8, {kNumStickyActions}, [](const Match &match, void *out) {
         for (int i = 0; i < kNumStickyActions; i++) {
           static_cast<std::int8_t *>(out)[i] = match.holds(kStickyActions[i]);
         }
       }},
      {"reward", Type::kFloat32, {}, [](const Match &match, void *out) {
         *static_cast<float *>(out) = static_cast<float>(match.reward());
       }},
      {"terminated", Type::kBool, {}, [](const Match &match, void *out) {
         *static_cast<bool *>(out) = match.terminated();
       }},
      {"truncated", Type::kBool, {}, [](const Match &match, void *out) {
         *static_cast<bool *>(out) = match.truncated();
       }},
  };
  add_team<&SharedInfo::left_team>(
      fields, {"left_team", "left_team_direction", "left_team_tired_factor",
               "left_team_yellow_card", "left_team_active", "left_team_roles"});
  add_team<&SharedInfo::right_team>(
      fields, {"right_team", "right_team_direction", "right_team_tired_factor",
               "right_team_yellow_card", "right_team_active", "right_team_roles"});
  return fields;
}

}  // namespace

const std::vector<Field> &fields() {
  static const std::vector<Field> all = make_fields();
  return all;
}

}  // namespace fbrl
