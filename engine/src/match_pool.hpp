// Matches of one scenario, played by a team of threads.
//
// The caller's thread plays none of them: it sends work and waits for it, so that a match that hangs
// keeps nobody from being told. A match that ends begins its next episode at once, on the thread that
// stepped it, while others still step.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "fields.hpp"

namespace fbrl {

// Where the numbers of the matches are written: for each field the address of the first match's, and
// the bytes from one match to the next. The memory is the caller's.
struct Column {
  const Field *field;
  char *data;
  std::ptrdiff_t stride;
};
using Rows = std::vector<Column>;

struct Episode {
  ScenarioConfig config;
  std::uint32_t engine_seed;
  std::int64_t number;
  // Where it begins, if not at its beginning.
  std::optional<MatchState> state = std::nullopt;
};

// What happens in place of a step, for measurements and tests: a sleep that stands for an engine on a
// core of its own, or one of the faults that an engine may have.
struct Disturbance {
  enum class Kind { kSleep, kHang, kThrow, kAbort };

  Kind kind;
  // In the episode of this seed alone, or in all of them.
  std::optional<std::uint32_t> engine_seed;
  // How long a sleep takes: this, give or take up to the spread. One step in so many, drawn as well,
  // takes the time of a reset longer; none with 0.
  std::chrono::duration<double> sleep{0}, spread{0}, reset{0};
  int steps_per_reset = 0;
};

// Work that was sent together.
class Batch;

class MatchPool {
 public:
  MatchPool(std::string scenario, int num_matches, int num_threads, int frame_skip,
            std::string data_dir);
  // Waits for what is being played, a second at most: a match that hangs is left to the process's end.
  ~MatchPool();
  MatchPool(const MatchPool &) = delete;
  MatchPool &operator=(const MatchPool &) = delete;

  int num_matches() const;

  // Says which episode a match begins next. Throws std::invalid_argument for a scenario that the engine
  // can't play.
  void prepare(int match, Episode episode);

  // Each returns at once, and throws std::logic_error where a match is not in a state for it. Rows are
  // written by the time that the batch is done.
  std::shared_ptr<Batch> send_begin(const std::vector<int> &matches, std::shared_ptr<const Rows> rows);
  // With next_rows, the matches that end go on with the episodes that are prepared for them, and what the
  // next step begins with is written there; without, they wait for send_begin.
  std::shared_ptr<Batch> send_step(const std::vector<int> &matches, const std::vector<int> &actions,
                                   std::shared_ptr<const Rows> rows,
                                   std::shared_ptr<const Rows> next_rows = nullptr);
  // Whether the batch was done in this time. Throws what a match of it threw, with the match's name.
  bool wait(Batch &batch, std::chrono::milliseconds timeout);

  MatchState state(int match);
  bool is_running(int match) const;

  // What is being played at this moment: a number that no other work has, and the match in words.
  std::vector<std::pair<std::uint64_t, std::string>> in_hand() const;

  // From the next step that is sent.
  void disturb(std::optional<Disturbance> disturbance);

 private:
  struct Shared;
  class Sending;
  std::shared_ptr<Shared> shared_;
};

}  // namespace fbrl
