#pragma once

#include <pybind11/pybind11.h>

#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include "server/app/config.hpp"
#include "server/app/offline/cut_run.hpp"
#include "server/app/python/forces.hpp"
#include "server/app/python/module.hpp"
#include "server/core/session/cut_session.hpp"

namespace incise::python {

// A body and the blades that cut it.
//
// Thread: any, one at a time: a second one gets an exception (Use). The GIL is released while the core works.
struct Session {
  std::shared_ptr<const Body> body;
  app::Config config;
  std::string blade_fault;  // why no pose can be taken: it is out of proportion to the body; empty: nothing
  std::unique_ptr<core::CutSession> core;
  std::unique_ptr<ForceTrace> forces;  // null: none are wanted
  std::atomic<bool> busy = false;
};

// Holds a session for one call.
class Use {
 public:
  explicit Use(Session& session) : session_(session) {
    if (session.busy.exchange(true))
      throw std::runtime_error(
          "this session is in use by another thread; give each thread a session of its own");
  }
  ~Use() { session_.busy = false; }
  Use(const Use&) = delete;
  Use& operator=(const Use&) = delete;
  core::CutSession& core() const { return *session_.core; }

 private:
  Session& session_;
};

// What one motion has done to a session.
struct Cut {
  std::shared_ptr<Session> session;
  std::vector<std::shared_ptr<core::Delta>> deltas;
  py::object forces = py::none();  // (n, 3)
  py::object report = py::none();  // a dict
  std::vector<std::string> warnings;
};

// Takes note of what a motion does, and raises KeyboardInterrupt. Called without the GIL.
class Recorder {
 public:
  Recorder(const app::Config& config, ForceTrace* forces, bool deltas)
      : config_(config), forces_(forces), wanted_(deltas) {
    if (forces_) forces_->begin();
  }
  void event(const app::MotionEvent& event);
  void commit(const core::CutSession& session, const core::Delta& delta);
  // With the GIL held.
  void finish(Cut& cut);

 private:
  const app::Config& config_;
  ForceTrace* const forces_;
  const bool wanted_;
  std::vector<std::shared_ptr<core::Delta>> deltas_;
  std::uint32_t events_ = 0;
};

// Cuts a session's body by a motion, as the server would.
Cut cut_session(const std::shared_ptr<Session>& session, const Motion& motion, bool deltas);
// What `incise cut` does.
Cut cut_body(const py::object& body, const py::object& poses, const py::object& config,
             const Choices& choices, bool strict, bool deltas, bool forces);

}  // namespace incise::python
