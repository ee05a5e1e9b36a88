//! What is larger than the rules allow, each with its size. These lists only shrink: whatever becomes smaller than its entry fails the
//! test until the entry says so.

/// Structures of the core with more than 15 fields.
pub const FIELDS: &[(&str, usize)] = &[];

/// Types of the core, by room, whose methods stand in more than 3 files.
pub const IMPL_FILES: &[(&str, usize)] = &[];

/// Functions of more than 60 lines.
pub const LINES: &[(&str, usize)] = &[];

/// Functions of more than 15 branches.
pub const BRANCHES: &[(&str, usize)] = &[("FaultCase::faults", 23), ("solve_velocity", 16)];

/// Type names that stand in more than one file.
pub const NAMES: &[(&str, usize)] = &[];
