#include "match_bindings.hpp"

#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "match_pool.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using fbrl::MatchPool;
using Array = nb::ndarray<nb::device::cpu>;

constexpr std::chrono::milliseconds kBetweenLooksForSignals{50};
constexpr std::chrono::seconds kForWhatIsBeingPlayed{5};

nb::dlpack::dtype dtype_of(fbrl::Type type) {
  switch (type) {
    case fbrl::Type::kBool:
      return nb::dtype<bool>();
    case fbrl::Type::kInt8:
      return nb::dtype<std::int8_t>();
    case fbrl::Type::kInt64:
      return nb::dtype<std::int64_t>();
    case fbrl::Type::kFloat32:
      return nb::dtype<float>();
  }
  throw std::logic_error("a type without a dtype");
}

const char *name_of(fbrl::Type type) {
  switch (type) {
    case fbrl::Type::kBool:
      return "bool";
    case fbrl::Type::kInt8:
      return "int8";
    case fbrl::Type::kInt64:
      return "int64";
    case fbrl::Type::kFloat32:
      return "float32";
  }
  throw std::logic_error("a type without a name");
}

const fbrl::Field &field_named(const std::string &name) {
  for (const fbrl::Field &field : fbrl::fields()) {
    if (name == field.name) return field;
  }
  throw nb::key_error(("There is no field " + name + " of a match.").c_str());
}

// Memory of arrays that matches write to, kept alive with it.
struct PyRows {
  std::shared_ptr<const fbrl::Rows> rows;
  std::size_t num_matches;
  nb::dict arrays;
};

fbrl::Column column_of(const std::string &name, const Array &array) {
  const fbrl::Field &field = field_named(name);
  bool fits = array.dtype() == dtype_of(field.type) && array.ndim() == field.shape.size() + 1;
  std::int64_t stride = 1;
  for (std::size_t axis = field.shape.size(); fits && axis > 0; axis--) {
    fits = static_cast<int>(array.shape(axis)) == field.shape[axis - 1] && array.stride(axis) == stride;
    stride *= field.shape[axis - 1];
  }
  if (!fits) {
    std::string shape = "(matches";
    for (int size : field.shape) shape += ", " + std::to_string(size);
    throw std::invalid_argument("The array for " + name + " must be of " + name_of(field.type) +
                                " and shape " + shape + "), a match's numbers side by side.");
  }
  const std::ptrdiff_t size = array.itemsize();
  return {&field, static_cast<char *>(array.data()), static_cast<std::ptrdiff_t>(array.stride(0)) * size};
}

PyRows make_rows(nb::dict arrays) {
  fbrl::Rows rows;
  std::size_t num_matches = 0;
  for (auto [key, value] : arrays) {
    const Array array = nb::cast<Array>(value);
    rows.push_back(column_of(nb::cast<std::string>(key), array));
    if (rows.size() > 1 && array.shape(0) != num_matches) {
      throw std::invalid_argument("The arrays are for different numbers of matches.");
    }
    num_matches = array.shape(0);
  }
  return {std::make_shared<const fbrl::Rows>(std::move(rows)), num_matches, std::move(arrays)};
}

class PyBatch {
 public:
  PyBatch(std::shared_ptr<MatchPool> pool, std::shared_ptr<fbrl::Batch> batch, nb::object rows)
      : pool_(std::move(pool)), batch_(std::move(batch)), rows_(std::move(rows)) {}
  PyBatch(PyBatch &&) = default;

  ~PyBatch() {
    if (!batch_) return;
    bool done = false;
    try {
      nb::gil_scoped_release release;
      done = pool_->wait(*batch_, kForWhatIsBeingPlayed);
    } catch (const std::exception &) {
      done = true;
    }
    // A match that hangs may still write: its memory is given up.
    if (!done) rows_.release();
  }

  void wait() {
    while (true) {
      {
        nb::gil_scoped_release release;
        if (pool_->wait(*batch_, kBetweenLooksForSignals)) return;
      }
      if (PyErr_CheckSignals() != 0) {
        // No match is left being played behind the caller's back.
        nb::gil_scoped_release release;
        pool_->wait(*batch_, kForWhatIsBeingPlayed);
        break;
      }
    }
    throw nb::python_error();
  }

 private:
  std::shared_ptr<MatchPool> pool_;
  std::shared_ptr<fbrl::Batch> batch_;
  nb::object rows_;
};

const std::shared_ptr<const fbrl::Rows> &rows_for(const MatchPool &pool, nb::handle rows) {
  const PyRows &of = nb::cast<PyRows &>(rows);
  if (!of.rows->empty() && of.num_matches != static_cast<std::size_t>(pool.num_matches())) {
    throw std::invalid_argument("The rows are for " + std::to_string(of.num_matches) + " matches, not " +
                                std::to_string(pool.num_matches()) + ".");
  }
  return of.rows;
}

struct PyMatches {
  std::shared_ptr<MatchPool> pool;
};

const std::shared_ptr<MatchPool> &open(const PyMatches &matches) {
  if (!matches.pool) throw std::logic_error("The matches are closed: make new ones.");
  return matches.pool;
}

fbrl::Disturbance::Kind disturbance_named(const std::string &kind) {
  using Kind = fbrl::Disturbance::Kind;
  if (kind == "sleep") return Kind::kSleep;
  if (kind == "hang") return Kind::kHang;
  if (kind == "throw") return Kind::kThrow;
  if (kind == "abort") return Kind::kAbort;
  throw std::invalid_argument("The kind of disturbance is " + kind + "; there are sleep, hang, throw, abort.");
}

nb::dict fields_for_python() {
  nb::dict all;
  for (const fbrl::Field &field : fbrl::fields()) {
    nb::list shape;
    for (int size : field.shape) shape.append(size);
    all[field.name] = nb::make_tuple(nb::tuple(shape), name_of(field.type));
  }
  return all;
}

}  // namespace

void bind_matches(nb::module_ &module) {
  module.attr("FIELDS") = fields_for_python();
  module.attr("NUM_ACTIONS") = fbrl::kNumActions;
  module.attr("MAX_PLAYERS") = fbrl::kMaxPlayers;

  nb::class_<PyRows>(module, "Rows",
                     "Arrays that matches write what is observed of them to.\n\n"
                     "Args:\n"
                     "    arrays: For each name in FIELDS an array of shape (matches, *shape of the\n"
                     "        field) and its dtype, in the CPU's memory. The first axis may have any stride.\n")
      .def("__init__", [](PyRows *rows, nb::dict arrays) { new (rows) PyRows(make_rows(std::move(arrays))); },
           "arrays"_a)
      .def_ro("arrays", &PyRows::arrays);

  nb::class_<PyBatch>(module, "Batch", "Work that was sent together; what is not waited for is finished first.")
      .def("wait", &PyBatch::wait,
           "Returns when all of it is done.\n\n"
           "Raises:\n"
           "    RuntimeError: A match failed; the message names it. Its next episode begins anew.\n"
           "    ValueError: A state was not one of the match.\n");

  nb::class_<fbrl::Disturbance>(module, "Disturbance",
                                "What happens in place of a step, for measurements and tests.\n\n"
                                "Args:\n"
                                "    kind: 'sleep' for seconds, as an engine on a core of its own would take;\n"
                                "        'hang', 'throw' or 'abort', the faults that an engine may have.\n"
                                "    engine_seed: Of the episode in which it happens; None for all.\n"
                                "    seconds: How long a sleep takes.\n"
                                "    spread: Seconds that it is drawn to be shorter or longer, at most.\n"
                                "    reset_seconds: How much longer one step in steps_per_reset takes, drawn too.\n"
                                "    steps_per_reset: 0 for none.\n")
      .def("__init__",
           [](fbrl::Disturbance *disturbance, const std::string &kind,
              std::optional<std::uint32_t> engine_seed, double seconds, double spread,
              double reset_seconds, int steps_per_reset) {
             using Seconds = std::chrono::duration<double>;
             new (disturbance) fbrl::Disturbance{disturbance_named(kind), engine_seed, Seconds(seconds),
                                                 Seconds(spread), Seconds(reset_seconds), steps_per_reset};
           },
           "kind"_a, "engine_seed"_a = nb::none(), "seconds"_a = 0.0, "spread"_a = 0.0,
           "reset_seconds"_a = 0.0, "steps_per_reset"_a = 0);

  nb::class_<PyMatches>(module, "Matches", nb::is_weak_referenceable())
      .def("__init__",
           [](PyMatches *matches, std::string scenario, int num_matches, int num_threads,
              int frame_skip, std::string data_dir) {
             new (matches) PyMatches{std::make_shared<MatchPool>(
                 std::move(scenario), num_matches, num_threads, frame_skip, std::move(data_dir))};
           },
           "scenario"_a, "num_matches"_a, "num_threads"_a, "frame_skip"_a, "data_dir"_a)
      .def("prepare",
           [](PyMatches &matches, int match, const ScenarioConfig &config, std::uint32_t engine_seed,
              std::int64_t episode_number) {
             open(matches)->prepare(match, {config, engine_seed, episode_number});
           },
           "match"_a, "config"_a, "engine_seed"_a, "episode_number"_a,
           "Says which episode a match begins next: with begin(), and by itself when it ends.")
      .def("prepare_state",
           [](PyMatches &matches, int match, const ScenarioConfig &config, std::uint32_t engine_seed,
              std::int64_t episode_number, const nb::bytes &engine, int waiting_steps,
              int previous_score_difference, int previous_game_mode, int previous_ball_owned_team) {
             fbrl::MatchState state{{engine.c_str(), engine.size()}, waiting_steps,
                                    previous_score_difference, previous_game_mode,
                                    previous_ball_owned_team};
             open(matches)->prepare(match, {config, engine_seed, episode_number, std::move(state)});
           },
           "match"_a, "config"_a, "engine_seed"_a, "episode_number"_a, "engine"_a, "waiting_steps"_a,
           "previous_score_difference"_a, "previous_game_mode"_a, "previous_ball_owned_team"_a,
           "The same, but has the episode begin in a state of it.")
      .def("send_begin",
           [](PyMatches &matches, const std::vector<int> &which, nb::object rows) {
             return PyBatch(open(matches), open(matches)->send_begin(which, rows_for(*open(matches), rows)), rows);
           },
           "matches"_a, "rows"_a, "Has these matches begin the episodes that are prepared.")
      .def("send_step",
           [](PyMatches &matches, const std::vector<int> &which, const std::vector<int> &actions,
              nb::object rows, nb::object next_rows) {
             MatchPool &pool = *open(matches);
             const auto next = next_rows.is_none() ? nullptr : rows_for(pool, next_rows);
             return PyBatch(open(matches), pool.send_step(which, actions, rows_for(pool, rows), next),
                            nb::make_tuple(rows, next_rows));
           },
           "matches"_a, "actions"_a, "rows"_a, "next_rows"_a = nb::none(),
           "Has these matches play a step, each with its action.\n\n"
           "With next_rows those that end go on with the episodes that are prepared, and what the next\n"
           "step begins with is written there.")
      .def("state",
           [](PyMatches &matches, int match) {
             fbrl::MatchState state;
             {
               nb::gil_scoped_release release;
               state = open(matches)->state(match);
             }
             nb::dict all;
             all["engine"] = nb::bytes(state.engine.data(), state.engine.size());
             all["waiting_steps"] = state.waiting_steps;
             all["previous_score_difference"] = state.previous_score_difference;
             all["previous_game_mode"] = state.previous_game_mode;
             all["previous_ball_owned_team"] = state.previous_ball_owned_team;
             return all;
           },
           "match"_a, "What a running match goes on from, as prepare_state() takes it.")
      .def("is_running", [](PyMatches &matches, int match) { return open(matches)->is_running(match); },
           "match"_a, "Whether the match's episode has begun and not ended.")
      .def("in_hand",
           [](PyMatches &matches) {
             // Asked of all that there are, closed ones too.
             return matches.pool ? matches.pool->in_hand() : decltype(matches.pool->in_hand()){};
           },
           "What is being played now: a number that no other work has, and the match in words.")
      .def("disturb",
           [](PyMatches &matches, std::optional<fbrl::Disturbance> disturbance) {
             open(matches)->disturb(disturbance);
           },
           "disturbance"_a.none(), "Puts something in the place of steps, from the next one that is sent.")
      .def("close", [](PyMatches &matches) {
        nb::gil_scoped_release release;
        matches.pool.reset();
      },
           "Ends the threads, and hands the engines on to the next matches of the process.");
}
