//! Holdover keeps a drone navigating when GNSS drops: a navigator that is fed with samples and asked for solutions, and the daemon around it.
//!
//! # Layout
//!
//! Every room knows only those before it, and none of the core (all but the last line) reads a clock, a file or a socket, or draws a random
//! number that is not seeded.
//!
//! - Ground: [`time`] (clocks and spans), [`geo`] (rotations, WGS-84, magnetic field), [`sample`] (what sensors say).
//! - Estimation: [`filter`] (the Kalman filters that fly), [`altimeter`] (fault-tolerant height), [`camera`] (optical flow), [`landmark`]
//!   (position from known points), [`observer`] (the published nonlinear observers).
//! - Navigation: [`navigator`] (which source is believed, in which mode), [`outbound`] (what is told to the autopilot), [`pipeline`] (both,
//!   inputs in and messages out).
//! - Around it: [`wire`] (MAVLink), [`config`] (settings), [`metrics`] (errors and consistency), [`sim`] (simulated flights), [`replay`]
//!   (recorded flights) and their [`report`]s, and the daemon, the check before a flight and the command line ([`cli`]).
//!
//! # Example
//!
//! A simulated quadrotor loses GNSS for two minutes and goes on with optical flow:
//!
//! ```
//! use holdover::config::{Settings, Sources};
//! use holdover::navigator::solution::{Mode, VelocitySource};
//! use holdover::pipeline::Pipeline;
//! use holdover::sample::{Input, SampleKind};
//! use holdover::sim::models::ImuModel;
//! use holdover::sim::{Scenario, SensorSuite, Simulation};
//! use holdover::wire::clock::AutopilotClock;
//!
//! let scenario = Scenario::square();
//! let (lost_s, found_s) = scenario.outage_s.ok_or("no outage")?;
//! let simulation = Simulation::new(scenario.clone(), SensorSuite::of(&scenario, ImuModel::mems()), 1);
//! let mut pipeline = Pipeline::new(&Settings::load(&Sources::default())?.pipeline);
//! let (clock, mut messages, mut last) = (AutopilotClock::new(), Vec::new(), None);
//! for reading in simulation.take_while(|r| r.t_s < found_s) {
//!     pipeline.take(&clock, &Input::Status(scenario.status(reading.t_s)), &mut messages);
//!     for sample in reading.samples.iter() {
//!         if reading.t_s < lost_s || sample.kind() != SampleKind::Gnss {
//!             last = pipeline.take(&clock, &Input::Sample(*sample), &mut messages).or(last);
//!         }
//!     }
//! }
//! let solution = last.ok_or("no solution")?;
//! assert_eq!((solution.mode, solution.velocity_source), (Mode::Holdover, VelocitySource::Flow));
//! assert!(solution.horizontal_sigma_m() < 20.0);
//! // Nothing is told to an autopilot whose own frame is not known to agree with ours: none was heard here.
//! assert!(messages.is_empty());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod altimeter;
pub mod camera;
pub mod cli;
pub mod config;
mod daemon;
pub mod double;
pub mod export;
pub mod fault;
mod files;
pub mod filter;
mod fleet;
pub mod geo;
mod init;
pub mod landmark;
pub mod log;
pub mod metrics;
pub mod navigator;
pub mod observer;
pub mod outbound;
pub mod pipeline;
mod preflight;
mod record;
pub mod replay;
pub mod report;
pub mod sample;
pub mod sim;
pub mod state;
pub mod status;
pub mod time;
pub mod wire;
