//! What a vehicle that was listened to needs of a configuration, and of its owner.
//!
//! [`survey`] takes note of who speaks on a link and what of; [`verdict`] says of each sensor whether it is good enough; [`draft`] is a configuration
//! that holds only what differs, with the reasons; [`fitting`] is what of it follows from what was heard. Nothing here knows a link or a clock.

pub mod draft;
pub mod fitting;
pub mod survey;
pub mod verdict;
