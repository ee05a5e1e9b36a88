//! The Kalman filters that fly: the error-state filter that is published, and the bank that finds a heading from motion where nothing
//! else tells it.
//!
//! They are locally convergent and know how wrong they are; the observers in [`crate::observer`] are globally convergent and do not. So the
//! observers start the error-state filter and watch it.

pub mod error_state;
pub mod heading_bank;

pub use error_state::{AirModel, Eskf, EskfSettings, EskfState};
pub use heading_bank::{BankVerdict, HeadingBank, HeadingBankSettings, HeadingEstimate};
