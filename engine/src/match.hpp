// One match under gfootball's rules: which actions it takes, what a step is, when an episode ends.
//
// Repeats env/football_env_core.py step for step. A match may be used from any thread, by one at a
// time; nothing here knows of Python.
#pragma once

#include <memory>
#include <string>

#include "game_env.hpp"

namespace fbrl {

constexpr int kNumActions = 20;
// The action set "v2" of gfootball: its default one, and last the engine's own player.
extern const Action kActions[kNumActions];

constexpr int kNumStickyActions = 10;
// The actions of the default set that last until they are released, in its order.
extern const Action kStickyActions[kNumStickyActions];

// What decides how a match goes on, besides its scenario's configuration.
struct MatchState {
  std::string engine;
  int waiting_steps;
  int previous_score_difference;
  int previous_game_mode;
  int previous_ball_owned_team;
};

class Match {
 public:
  // An engine is taken or started by the first reset, on the thread that calls it.
  explicit Match(std::string data_dir) : data_dir_(std::move(data_dir)) {}

  // Plays in an engine that was started, which stays the caller's as well.
  explicit Match(GameEnv *engine) : data_dir_(engine->game_config.data_dir), env_(engine) {}

  // Starts an episode and steps on until the game is in play.
  void reset(ScenarioConfig config);

  // Plays 100 ms, and on until the game is in play, frame_skip times or up to the episode's end. The
  // action is an index into kActions. It is played the first time alone, as a button is pressed once,
  // but for the engine's own player; directions and sprinting last anyway.
  void step(int action, int frame_skip);

  MatchState state();

  // Goes on from a state. The match has been reset with the configuration of its episode.
  // Throws std::invalid_argument where it is seen not to be a state of such an episode.
  void restore(const MatchState &state);

  // Forgets an engine that failed, the next reset starts another one.
  void abandon_engine();

  // After the last reset or step.
  const SharedInfo &info() const { return info_; }
  bool holds(Action sticky_action) const { return env_->sticky_action_state(sticky_action, true, 0); }
  int steps_left() const { return env_->scenario_config.game_duration - info_.step; }
  int reward() const { return reward_; }
  bool terminated() const { return terminated_; }
  bool truncated() const { return truncated_; }

 private:
  // Hands an engine on to the next match of the process.
  struct HandOn {
    void operator()(GameEnv *env) const;
  };

  void acquire_engine();
  void step_once(int action);
  void step_engine();
  void read_info();
  Action permitted(int action) const;
  bool ended_by_rule() const;

  const std::string data_dir_;
  std::unique_ptr<GameEnv, HandOn> env_;
  SharedInfo info_;
  int previous_score_difference_ = 0;
  int previous_game_mode_ = -1;
  int previous_ball_owned_team_ = -1;
  int reward_ = 0;
  bool terminated_ = false;
  bool truncated_ = false;
};

}  // namespace fbrl
