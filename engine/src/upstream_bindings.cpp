#include "upstream_bindings.hpp"

#include <nanobind/stl/bind_vector.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>

#include "game_env.hpp"

namespace nb = nanobind;
using namespace nb::literals;

NB_MAKE_OPAQUE(std::vector<FormationEntry>)
NB_MAKE_OPAQUE(std::vector<PlayerInfo>)
NB_MAKE_OPAQUE(std::vector<ControllerInfo>)

namespace {

nb::bytes as_bytes(const std::string &text) { return nb::bytes(text.data(), text.size()); }

std::string as_string(const nb::bytes &bytes) { return {bytes.c_str(), bytes.size()}; }

float coordinate(const Position &position, int index) {
  // Python ends an iteration by an IndexError.
  if (index < 0 || index > 2) throw nb::index_error();
  return position.env_coord(index);
}

void bind_enums(nb::module_ &module) {
  nb::enum_<GameState>(module, "GameState", nb::is_arithmetic())
      .value("game_created", game_created)
      .value("game_initiated", game_initiated)
      .value("game_running", game_running)
      .value("game_done", game_done);
  nb::enum_<e_PlayerRole>(module, "e_PlayerRole", nb::is_arithmetic())
      .value("e_PlayerRole_GK", e_PlayerRole_GK)
      .value("e_PlayerRole_CB", e_PlayerRole_CB)
      .value("e_PlayerRole_LB", e_PlayerRole_LB)
      .value("e_PlayerRole_RB", e_PlayerRole_RB)
      .value("e_PlayerRole_DM", e_PlayerRole_DM)
      .value("e_PlayerRole_CM", e_PlayerRole_CM)
      .value("e_PlayerRole_LM", e_PlayerRole_LM)
      .value("e_PlayerRole_RM", e_PlayerRole_RM)
      .value("e_PlayerRole_AM", e_PlayerRole_AM)
      .value("e_PlayerRole_CF", e_PlayerRole_CF);
  nb::enum_<e_RenderingMode>(module, "e_RenderingMode", nb::is_arithmetic())
      .value("e_Disabled", e_Disabled)
      .value("e_Onscreen", e_Onscreen)
      .value("e_Offscreen", e_Offscreen);
  nb::enum_<e_GameMode>(module, "e_GameMode", nb::is_arithmetic())
      .value("e_GameMode_Normal", e_GameMode_Normal)
      .value("e_GameMode_KickOff", e_GameMode_KickOff)
      .value("e_GameMode_GoalKick", e_GameMode_GoalKick)
      .value("e_GameMode_FreeKick", e_GameMode_FreeKick)
      .value("e_GameMode_Corner", e_GameMode_Corner)
      .value("e_GameMode_ThrowIn", e_GameMode_ThrowIn)
      .value("e_GameMode_Penalty", e_GameMode_Penalty);
  nb::enum_<Action>(module, "e_BackendAction", nb::is_arithmetic())
      .value("idle", game_idle)
      .value("left", game_left)
      .value("top_left", game_top_left)
      .value("top", game_top)
      .value("top_right", game_top_right)
      .value("right", game_right)
      .value("bottom_right", game_bottom_right)
      .value("bottom", game_bottom)
      .value("bottom_left", game_bottom_left)
      .value("long_pass", game_long_pass)
      .value("high_pass", game_high_pass)
      .value("short_pass", game_short_pass)
      .value("shot", game_shot)
      .value("keeper_rush", game_keeper_rush)
      .value("sliding", game_sliding)
      .value("pressure", game_pressure)
      .value("team_pressure", game_team_pressure)
      .value("switch", game_switch)
      .value("sprint", game_sprint)
      .value("dribble", game_dribble)
      .value("release_direction", game_release_direction)
      .value("release_long_pass", game_release_long_pass)
      .value("release_high_pass", game_release_high_pass)
      .value("release_short_pass", game_release_short_pass)
      .value("release_shot", game_release_shot)
      .value("release_keeper_rush", game_release_keeper_rush)
      .value("release_sliding", game_release_sliding)
      .value("release_pressure", game_release_pressure)
      .value("release_team_pressure", game_release_team_pressure)
      .value("release_switch", game_release_switch)
      .value("release_sprint", game_release_sprint)
      .value("release_dribble", game_release_dribble)
      .value("builtin_ai", game_builtin_ai);
  nb::enum_<e_Team>(module, "e_Team", nb::is_arithmetic())
      .value("e_Left", e_Left)
      .value("e_Right", e_Right);
}

void bind_scenario(nb::module_ &module) {
  nb::class_<Vector3>(module, "Vector3")
      .def(nb::init<float, float, float>())
      .def("__getitem__",
           [](const Vector3 &vector, int index) {
             if (index < 0 || index > 2) throw nb::index_error();
             return vector.GetEnvCoord(index);
           })
      .def("__setitem__", [](Vector3 &vector, int index, float value) {
        if (index < 0 || index > 2) throw nb::index_error();
        vector.SetEnvCoord(index, value);
      });
  nb::class_<FormationEntry>(module, "FormationEntry")
      .def(nb::init<float, float, e_PlayerRole, bool, bool>())
      .def_ro("role", &FormationEntry::role)
      .def_prop_ro("position", &FormationEntry::position_env)
      .def_rw("lazy", &FormationEntry::lazy)
      .def_rw("controllable", &FormationEntry::controllable);
  nb::bind_vector<std::vector<FormationEntry>>(module, "FormationEntryVec");
  nb::class_<ScenarioConfig>(module, "ScenarioConfig")
      .def_static("make", &ScenarioConfig::make)
      .def_rw("ball_position", &ScenarioConfig::ball_position)
      .def_rw("left_team", &ScenarioConfig::left_team)
      .def_rw("right_team", &ScenarioConfig::right_team)
      .def_rw("left_agents", &ScenarioConfig::left_agents)
      .def_rw("right_agents", &ScenarioConfig::right_agents)
      .def_rw("use_magnet", &ScenarioConfig::use_magnet)
      .def_rw("game_engine_random_seed", &ScenarioConfig::game_engine_random_seed)
      .def_rw("reverse_team_processing", &ScenarioConfig::reverse_team_processing)
      .def_rw("offsides", &ScenarioConfig::offsides)
      .def_rw("real_time", &ScenarioConfig::real_time)
      .def_rw("left_team_difficulty", &ScenarioConfig::left_team_difficulty)
      .def_rw("right_team_difficulty", &ScenarioConfig::right_team_difficulty)
      .def_rw("deterministic", &ScenarioConfig::deterministic)
      .def_rw("end_episode_on_score", &ScenarioConfig::end_episode_on_score)
      .def_rw("end_episode_on_possession_change",
              &ScenarioConfig::end_episode_on_possession_change)
      .def_rw("end_episode_on_out_of_play", &ScenarioConfig::end_episode_on_out_of_play)
      .def_rw("game_duration", &ScenarioConfig::game_duration)
      .def_rw("second_half", &ScenarioConfig::second_half)
      .def_rw("control_all_players", &ScenarioConfig::control_all_players)
      // Methods, as upstream has them.
      .def("dynamic_player_selection", &ScenarioConfig::DynamicPlayerSelection)
      .def("controllable_left_players", &ScenarioConfig::ControllableLeftPlayers)
      .def("controllable_right_players", &ScenarioConfig::ControllableRightPlayers);
}

void bind_info(nb::module_ &module) {
  nb::class_<Position>(module, "Position")
      .def("__getitem__", &coordinate)
      .def("__str__", &Position::debug);
  nb::class_<PlayerInfo>(module, "PlayerInfo")
      .def_ro("position", &PlayerInfo::player_position)
      .def_ro("direction", &PlayerInfo::player_direction)
      .def_ro("tired_factor", &PlayerInfo::tired_factor)
      .def_ro("has_card", &PlayerInfo::has_card)
      .def_ro("is_active", &PlayerInfo::is_active)
      .def_ro("role", &PlayerInfo::role)
      .def_ro("designated_player", &PlayerInfo::designated_player);
  nb::bind_vector<std::vector<PlayerInfo>>(module, "PlayerInfoVec");
  nb::class_<ControllerInfo>(module, "ControllerInfo")
      .def(nb::init<int>())
      .def_ro("controlled_player", &ControllerInfo::controlled_player);
  nb::bind_vector<std::vector<ControllerInfo>>(module, "ControllerInfoVec");
  nb::class_<SharedInfo>(module, "SharedInfo")
      .def_ro("ball_position", &SharedInfo::ball_position)
      .def_ro("ball_rotation", &SharedInfo::ball_rotation)
      .def_ro("ball_direction", &SharedInfo::ball_direction)
      .def_ro("left_team", &SharedInfo::left_team)
      .def_ro("right_team", &SharedInfo::right_team)
      .def_ro("left_goals", &SharedInfo::left_goals)
      .def_ro("right_goals", &SharedInfo::right_goals)
      .def_ro("is_in_play", &SharedInfo::is_in_play)
      .def_ro("ball_owned_team", &SharedInfo::ball_owned_team)
      .def_ro("ball_owned_player", &SharedInfo::ball_owned_player)
      .def_ro("left_controllers", &SharedInfo::left_controllers)
      .def_ro("right_controllers", &SharedInfo::right_controllers)
      .def_ro("game_mode", &SharedInfo::game_mode)
      .def_ro("step", &SharedInfo::step);
}

void bind_game_env(nb::module_ &module) {
  nb::class_<GameConfig>(module, "GameConfig")
      .def_static("make", &GameConfig::make)
      .def_rw("render", &GameConfig::render)
      .def_rw("physics_steps_per_frame", &GameConfig::physics_steps_per_frame)
      .def_rw("render_resolution_x", &GameConfig::render_resolution_x)
      .def_rw("render_resolution_y", &GameConfig::render_resolution_y);
  // Whoever calls has to see that one thread at a time does.
  const nb::call_guard<nb::gil_scoped_release> parallel;
  nb::class_<GameEnv>(module, "GameEnv")
      .def("__init__",
           [](GameEnv *env, const std::string &data_dir) {
             new (env) GameEnv();
             env->game_config.data_dir = data_dir;
           })
      .def("start_game", &GameEnv::start_game, parallel)
      .def("get_info",
           [](GameEnv &env) {
             // get_info() reads the engine that the thread used last, whichever it is called on.
             ContextHolder holder(&env);
             return env.get_info();
           })
      .def("get_frame",
           [](GameEnv &env) {
             ContextHolder holder(&env);
             return as_bytes(env.get_frame());
           })
      .def("perform_action", &GameEnv::action)
      .def("sticky_action_state", &GameEnv::sticky_action_state)
      .def("step",
           [](GameEnv &env) {
             ContextHolder holder(&env);
             env.step();
           },
           parallel)
      .def("get_state",
           [](GameEnv &env, const std::string &pickle) { return as_bytes(env.get_state(pickle)); })
      .def("get_state",
           [](GameEnv &env, const nb::bytes &pickle) {
             return as_bytes(env.get_state(as_string(pickle)));
           })
      .def("set_state",
           [](GameEnv &env, const nb::bytes &state) {
             return as_bytes(env.set_state(as_string(state)));
           })
      .def("reset", &GameEnv::reset, parallel)
      .def("render",
           [](GameEnv &env, bool swap_buffer) {
             ContextHolder holder(&env);
             env.render(swap_buffer);
           },
           parallel)
      .def_rw("config", &GameEnv::scenario_config)
      .def_rw("game_config", &GameEnv::game_config)
      .def_rw("state", &GameEnv::state)
      .def_rw("waiting_for_game_count", &GameEnv::waiting_for_game_count)
      .def("tracker_setup", &GameEnv::tracker_setup);
}

}  // namespace

void bind_upstream(nb::module_ &module) {
  bind_enums(module);
  bind_scenario(module);
  bind_info(module);
  bind_game_env(module);
}
