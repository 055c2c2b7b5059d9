#include "match.hpp"

#include <mutex>
#include <stdexcept>
#include <vector>

namespace fbrl {
namespace {

// gfootball restarts a match for a player who makes it wait: football_env_core.py, step().
constexpr int kWaitingStepsBeforeForcedPass = 20;
constexpr int kWaitingStepsBeforeTurningBack = 30;

constexpr int kIdle = 0, kBuiltinAi = kNumActions - 1;

// Behind the random numbers an engine's state has the scenario's rules and the seed.
constexpr std::size_t kConstantPart = 2512, kConstantPartEnd = 2580;
constexpr std::size_t kLargestState = 10'000'000;

// The engines of matches that are over. Upstream's can't be taken apart, and starting one takes time.
class IdleEngines {
 public:
  static IdleEngines &get() {
    // Never destroyed: a thread may still play at the process's end.
    static IdleEngines &engines = *new IdleEngines;
    return engines;
  }

  void add(GameEnv *env) {
    const std::lock_guard lock(mutex_);
    engines_.push_back(env);
  }

  GameEnv *take(const std::string &data_dir) {
    const std::lock_guard lock(mutex_);
    for (auto engine = engines_.begin(); engine != engines_.end(); engine++) {
      if ((*engine)->game_config.data_dir != data_dir) continue;
      GameEnv *env = *engine;
      engines_.erase(engine);
      return env;
    }
    return nullptr;
  }

 private:
  std::mutex mutex_;
  std::vector<GameEnv *> engines_;
};

}  // namespace

const Action kActions[kNumActions] = {
    game_idle,        game_left,           game_top_left,          game_top,
    game_top_right,   game_right,          game_bottom_right,      game_bottom,
    game_bottom_left, game_long_pass,      game_high_pass,         game_short_pass,
    game_shot,        game_sprint,         game_release_direction, game_release_sprint,
    game_sliding,     game_dribble,        game_release_dribble,   game_builtin_ai};

const Action kStickyActions[kNumStickyActions] = {
    game_left,         game_top_left, game_top,         game_top_right, game_right,
    game_bottom_right, game_bottom,   game_bottom_left, game_sprint,    game_dribble};

void Match::HandOn::operator()(GameEnv *env) const { IdleEngines::get().add(env); }

void Match::acquire_engine() {
  env_.reset(IdleEngines::get().take(data_dir_));
  if (env_) return;
  auto env = std::make_unique<GameEnv>();
  env->game_config.data_dir = data_dir_;
  env->start_game();
  env_.reset(env.release());
}

void Match::abandon_engine() {
  // What failed in the middle of a step can't be taken apart either: its memory is given up.
  static_cast<void>(env_.release());
}

void Match::reset(ScenarioConfig config) {
  if (!env_) acquire_engine();
  previous_score_difference_ = 0;
  previous_game_mode_ = -1;
  previous_ball_owned_team_ = -1;
  reward_ = 0;
  terminated_ = truncated_ = false;
  env_->state = game_running;
  env_->reset(config, false);
  read_info();
  while (!info_.is_in_play) step_engine();
}

void Match::step(int action, int frame_skip) {
  int reward = 0;
  do {
    step_once(action);
    reward += reward_;
    if (action != kBuiltinAi) action = kIdle;
  } while (--frame_skip > 0 && !terminated_ && !truncated_);
  reward_ = reward;
}

void Match::step_once(int action) {
  env_->action(permitted(action), true, 0);
  do {
    step_engine();
  } while (!info_.is_in_play);

  terminated_ = ended_by_rule();
  const int score_difference = info_.left_goals - info_.right_goals;
  reward_ = score_difference - previous_score_difference_;
  previous_score_difference_ = score_difference;
  previous_game_mode_ = info_.game_mode;
  if (info_.ball_owned_team != -1) previous_ball_owned_team_ = info_.ball_owned_team;
  if (info_.game_mode == e_GameMode_Normal) {
    env_->waiting_for_game_count = 0;
  } else {
    env_->waiting_for_game_count++;
  }
  truncated_ = !terminated_ && info_.step >= env_->scenario_config.game_duration;
}

Action Match::permitted(int action) const {
  const int waiting = env_->waiting_for_game_count;
  if (waiting < kWaitingStepsBeforeForcedPass) return kActions[action];
  if (waiting == kWaitingStepsBeforeForcedPass) return game_short_pass;
  if (info_.ball_owned_team == 0 &&
      info_.left_controllers[0].controlled_player == info_.ball_owned_player) {
    return waiting >= kWaitingStepsBeforeTurningBack ? game_left : game_right;
  }
  return game_idle;
}

bool Match::ended_by_rule() const {
  const ScenarioConfig &config = env_->scenario_config;
  if (config.end_episode_on_score && (info_.left_goals > 0 || info_.right_goals > 0)) return true;
  if (config.end_episode_on_out_of_play && info_.game_mode != e_GameMode_Normal &&
      previous_game_mode_ == e_GameMode_Normal) {
    return true;
  }
  return config.end_episode_on_possession_change && info_.ball_owned_team != -1 &&
         previous_ball_owned_team_ != -1 && info_.ball_owned_team != previous_ball_owned_team_;
}

void Match::step_engine() {
  {
    ContextHolder holder(env_.get());
    env_->step();
  }
  read_info();
}

void Match::read_info() {
  SetGame(env_.get());
  GetGameTask()->GetMatch()->GetState(&info_);
  info_.step = env_->context->step;
}

MatchState Match::state() {
  return {env_->get_state(""), env_->waiting_for_game_count, previous_score_difference_,
          previous_game_mode_, previous_ball_owned_team_};
}

void Match::restore(const MatchState &state) {
  const std::string &engine = state.engine;
  const std::string fresh = env_->get_state("");
  const std::size_t constant = kConstantPartEnd - kConstantPart;
  if (engine.size() < kConstantPartEnd || engine.size() > kLargestState ||
      engine.compare(kConstantPart, constant, fresh, kConstantPart, constant) != 0) {
    throw std::invalid_argument("the engine's state, of " + std::to_string(engine.size()) +
                                " bytes, is not that of a match of this scenario and seed");
  }
  env_->set_state(engine);
  env_->waiting_for_game_count = state.waiting_steps;
  previous_score_difference_ = state.previous_score_difference;
  previous_game_mode_ = state.previous_game_mode;
  previous_ball_owned_team_ = state.previous_ball_owned_team;
  read_info();
}

}  // namespace fbrl
