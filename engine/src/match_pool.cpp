#include "match_pool.hpp"

#include <condition_variable>
#include <cstdlib>
#include <deque>
#include <functional>
#include <mutex>
#include <random>
#include <stdexcept>
#include <thread>

namespace fbrl {

class Batch {
 public:
  int left = 0;
  std::string error;
  bool is_invalid = false;
};

namespace {

struct Slot {
  explicit Slot(const std::string &data_dir) : match(data_dir) {}

  Match match;
  std::optional<Episode> prepared;
  std::uint32_t engine_seed = 0;
  std::int64_t episode_number = 0;
  // The episode goes on: it has begun and not ended.
  bool running = false;
  // The prepared episode has begun already, after the end of the one before.
  bool begun_ahead = false;
  // Sent and not yet done.
  bool busy = false;
  // Being played, under this number.
  std::uint64_t in_hand = 0;
};

void write(const Match &match, int index, const Rows &rows) {
  for (const Column &column : rows) column.field->write(match, column.data + index * column.stride);
}

void begin_prepared(Slot &slot) {
  slot.match.reset(slot.prepared->config);
  if (slot.prepared->state) slot.match.restore(*slot.prepared->state);
}

void sleep(const Disturbance &disturbance) {
  // Not std::random_device, whose arc4random only systems from glibc 2.36 on have.
  const auto seed = std::hash<std::thread::id>{}(std::this_thread::get_id());
  thread_local std::minstd_rand random{static_cast<std::minstd_rand::result_type>(seed)};
  std::uniform_real_distribution<double> centred(-1, 1);
  auto time = disturbance.sleep + disturbance.spread * centred(random);
  const int steps = disturbance.steps_per_reset;
  if (steps > 0 && std::uniform_int_distribution<int>(1, steps)(random) == 1) time += disturbance.reset;
  std::this_thread::sleep_for(time);
}

// Plays a step, or what takes its place in this episode.
void step(Slot &slot, int action, int frame_skip, const std::optional<Disturbance> &disturbance) {
  if (!disturbance || disturbance->engine_seed.value_or(slot.engine_seed) != slot.engine_seed) {
    slot.match.step(action, frame_skip);
    return;
  }
  switch (disturbance->kind) {
    case Disturbance::Kind::kSleep:
      sleep(*disturbance);
      return;
    case Disturbance::Kind::kHang:
      while (true) std::this_thread::sleep_for(std::chrono::hours(1));
    case Disturbance::Kind::kThrow:
      throw std::runtime_error("a fault that was asked for");
    case Disturbance::Kind::kAbort:
      std::abort();
  }
}

}  // namespace

struct MatchPool::Shared {
  struct Job {
    int match;
    std::shared_ptr<Batch> batch;
    std::function<void(Slot &)> play;
  };

  const std::string scenario;
  const int frame_skip;
  std::optional<Disturbance> disturbance;
  std::vector<std::unique_ptr<Slot>> slots;

  mutable std::mutex mutex;
  std::condition_variable work, done;
  std::deque<Job> jobs;
  int threads_waiting = 0;
  std::uint64_t jobs_begun = 0;
  int threads = 0;
  bool ending = false;

  Shared(std::string name, int skip) : scenario(std::move(name)), frame_skip(skip) {}

  std::string describe(int match) const {
    const Slot &slot = *slots[match];
    return "match " + std::to_string(match) + " of " + scenario + " (engine seed " +
           std::to_string(slot.engine_seed) + ", episode " + std::to_string(slot.episode_number) + ")";
  }

  Slot &free_slot(int match) {
    Slot &slot = *slots.at(match);
    if (slot.busy) throw std::logic_error("Match " + std::to_string(match) + " is still being played.");
    return slot;
  }

  // Goes on to the episode that is prepared, which messages then name.
  void enter_prepared(Slot &slot) {
    slot.engine_seed = slot.prepared->engine_seed;
    slot.episode_number = slot.prepared->number;
  }

  // On the thread that plays the match, without the lock.
  void begin_next(Slot &slot) {
    {
      const std::lock_guard lock(mutex);
      enter_prepared(slot);
    }
    begin_prepared(slot);
    slot.prepared.reset();
    slot.running = true;
  }

  void play_jobs() {
    std::unique_lock lock(mutex);
    while (true) {
      threads_waiting++;
      work.wait(lock, [this] { return ending || !jobs.empty(); });
      threads_waiting--;
      if (ending) break;
      const Job job = std::move(jobs.front());
      jobs.pop_front();
      Slot &slot = *slots[job.match];
      slot.in_hand = ++jobs_begun;
      lock.unlock();
      std::string error;
      bool is_invalid = false;
      try {
        job.play(slot);
      } catch (const std::invalid_argument &exception) {
        error = exception.what();
        is_invalid = true;
      } catch (const std::exception &exception) {
        error = exception.what();
        slot.match.abandon_engine();
      }
      lock.lock();
      if (!error.empty()) {
        slot.running = slot.begun_ahead = false;
        job.batch->error = describe(job.match) + " failed: " + error;
        job.batch->is_invalid = is_invalid;
      }
      slot.in_hand = 0;
      slot.busy = false;
      if (--job.batch->left == 0) done.notify_all();
    }
    threads--;
    done.notify_all();
  }
};

// Holds the lock while work is sent, and only then wakes threads, which would wait for the lock.
class MatchPool::Sending {
 public:
  explicit Sending(Shared &shared) : shared_(shared), lock_(shared.mutex) {}
  ~Sending() {
    lock_.unlock();
    while (to_wake_-- > 0) shared_.work.notify_one();
  }
  Sending(const Sending &) = delete;
  Sending &operator=(const Sending &) = delete;

  void send(Shared::Job job) {
    shared_.slots[job.match]->busy = true;
    job.batch->left++;
    if (static_cast<int>(shared_.jobs.size()) < shared_.threads_waiting) to_wake_++;
    shared_.jobs.push_back(std::move(job));
  }

 private:
  Shared &shared_;
  std::unique_lock<std::mutex> lock_;
  int to_wake_ = 0;
};

MatchPool::MatchPool(std::string scenario, int num_matches, int num_threads, int frame_skip,
                     std::string data_dir)
    : shared_(std::make_shared<Shared>(std::move(scenario), frame_skip)) {
  if (frame_skip < 1) throw std::invalid_argument("The frame skip has to be at least 1.");
  for (int i = 0; i < num_matches; i++) {
    shared_->slots.push_back(std::make_unique<Slot>(data_dir));
  }
  shared_->threads = num_threads;
  // They own what they work on, so that one that hangs does not use what is gone.
  for (int i = 0; i < num_threads; i++) {
    std::thread([shared = shared_] { shared->play_jobs(); }).detach();
  }
}

MatchPool::~MatchPool() {
  std::unique_lock lock(shared_->mutex);
  shared_->ending = true;
  shared_->jobs.clear();
  shared_->work.notify_all();
  shared_->done.wait_for(lock, std::chrono::seconds(1), [this] { return shared_->threads == 0; });
}

int MatchPool::num_matches() const { return static_cast<int>(shared_->slots.size()); }

void MatchPool::prepare(int match, Episode episode) {
  for (const auto *team : {&episode.config.left_team, &episode.config.right_team}) {
    if (team->empty() || team->size() > kMaxPlayers) {
      throw std::invalid_argument("A team of " + shared_->scenario + " has " +
                                  std::to_string(team->size()) + " players; the engine plays 1 to " +
                                  std::to_string(kMaxPlayers) + ".");
    }
  }
  const std::lock_guard lock(shared_->mutex);
  Slot &slot = shared_->free_slot(match);
  slot.prepared = std::move(episode);
  slot.begun_ahead = false;
}

std::shared_ptr<Batch> MatchPool::send_begin(const std::vector<int> &matches,
                                             std::shared_ptr<const Rows> rows) {
  Sending sending(*shared_);
  for (int match : matches) {
    if (!shared_->free_slot(match).prepared) {
      throw std::logic_error("Match " + std::to_string(match) + " has no episode prepared.");
    }
  }
  auto batch = std::make_shared<Batch>();
  for (int match : matches) {
    shared_->enter_prepared(*shared_->slots[match]);
    sending.send({match, batch, [match, rows](Slot &slot) {
                     if (!slot.begun_ahead) begin_prepared(slot);
                     slot.begun_ahead = false;
                     slot.prepared.reset();
                     slot.running = true;
                     write(slot.match, match, *rows);
                   }});
  }
  return batch;
}

std::shared_ptr<Batch> MatchPool::send_step(const std::vector<int> &matches,
                                            const std::vector<int> &actions,
                                            std::shared_ptr<const Rows> rows,
                                            std::shared_ptr<const Rows> next_rows) {
  Sending sending(*shared_);
  for (int match : matches) {
    const Slot &slot = shared_->free_slot(match);
    if (!slot.running) throw std::logic_error("Match " + std::to_string(match) + " is not running.");
    if (next_rows && !slot.prepared) {
      throw std::logic_error("Match " + std::to_string(match) + " has no episode prepared.");
    }
  }
  auto batch = std::make_shared<Batch>();
  for (std::size_t i = 0; i < matches.size(); i++) {
    const int match = matches[i], action = actions.at(i);
    if (action < 0 || action >= kNumActions) throw std::logic_error("There is no such action.");
    sending.send({match, batch,
                   [match, action, rows, next_rows, shared = shared_.get(),
                    disturbance = shared_->disturbance](Slot &slot) {
                     step(slot, action, shared->frame_skip, disturbance);
                     write(slot.match, match, *rows);
                     if (!slot.match.terminated() && !slot.match.truncated()) {
                       if (next_rows) write(slot.match, match, *next_rows);
                       return;
                     }
                     slot.running = false;
                     if (!slot.prepared) return;
                     if (!next_rows) {
                       begin_prepared(slot);
                       slot.begun_ahead = true;
                       return;
                     }
                     shared->begin_next(slot);
                     write(slot.match, match, *next_rows);
                   }});
  }
  return batch;
}

bool MatchPool::wait(Batch &batch, std::chrono::milliseconds timeout) {
  std::unique_lock lock(shared_->mutex);
  if (!shared_->done.wait_for(lock, timeout, [&batch] { return batch.left == 0; })) return false;
  if (batch.error.empty()) return true;
  if (batch.is_invalid) throw std::invalid_argument(batch.error);
  throw std::runtime_error(batch.error);
}

MatchState MatchPool::state(int match) {
  Slot *slot;
  {
    const std::lock_guard lock(shared_->mutex);
    slot = &shared_->free_slot(match);
    if (!slot->running) throw std::logic_error("Match " + std::to_string(match) + " is not running.");
  }
  return slot->match.state();
}

bool MatchPool::is_running(int match) const {
  const std::lock_guard lock(shared_->mutex);
  const Slot &slot = *shared_->slots.at(match);
  return !slot.busy && slot.running;
}

std::vector<std::pair<std::uint64_t, std::string>> MatchPool::in_hand() const {
  const std::lock_guard lock(shared_->mutex);
  std::vector<std::pair<std::uint64_t, std::string>> all;
  for (std::size_t i = 0; i < shared_->slots.size(); i++) {
    if (const std::uint64_t number = shared_->slots[i]->in_hand) {
      all.emplace_back(number, shared_->describe(static_cast<int>(i)));
    }
  }
  return all;
}

void MatchPool::disturb(std::optional<Disturbance> disturbance) {
  const std::lock_guard lock(shared_->mutex);
  shared_->disturbance = disturbance;
}

}  // namespace fbrl
