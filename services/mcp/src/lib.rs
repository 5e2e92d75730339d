//! The tools of an agent: looking, planning, executing, stopping.
