//! Reports of flights: one page each that needs nothing else, with every plot as SVG.
//!
//! [`FlightRecorder`] keeps, while a log is played, what the plots are made of, decimated so that extremes stay; [`flights_page`] draws them. [`FleetSheet`] shows what an evaluation
//! of many says together.
//! Every colour means the same thing on every plot (`palette`), every drawing says what its sides are, so that its values can be read back,
//! and where there is nothing to draw the page says what is lacking. Whatever comes from a log is text (`html`).

mod chart;
mod fleet;
mod flight;
mod html;
mod lanes;
mod page;
mod palette;
mod recorder;
mod scale;
mod trace;
mod views;

pub use fleet::FleetSheet;
pub use flight::{FaultShown, FlightSheet, flights_page};
pub use recorder::FlightRecorder;
