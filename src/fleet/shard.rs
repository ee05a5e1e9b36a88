//! Which part of a list a process works on.

use std::fmt;
use std::str::FromStr;

/// Shard `index` of `of`: every `of`-th log of the list, from the `index`-th on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    index: u32,
    of: u32,
}

/// More shards than any cluster runs.
const MOST_SHARDS: u32 = 100_000;

/// Why something is no shard.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ShardError(String);

impl Shard {
    /// The whole list.
    pub const WHOLE: Self = Self { index: 0, of: 1 };

    /// Shard `index` of `of`.
    ///
    /// # Errors
    /// An index that is not below the number of shards.
    pub fn new(index: u32, of: u32) -> Result<Self, ShardError> {
        if of == 0 || of > MOST_SHARDS {
            return Err(ShardError(format!("{of} shards: from 1 to {MOST_SHARDS} there may be")));
        }
        if index >= of {
            return Err(ShardError(format!("shard {index} of {of}: they are numbered from 0 to {}", of - 1)));
        }
        Ok(Self { index, of })
    }

    /// Its number, from 0.
    pub fn index(self) -> u32 {
        self.index
    }

    /// How many there are.
    pub fn of(self) -> u32 {
        self.of
    }

    /// Whether the `place`-th of the list belongs to it. Neighbours in a list, of one vehicle and one day, are spread over all shards.
    pub fn holds(self, place: usize) -> bool {
        place % self.of as usize == self.index as usize
    }

    /// What `I/N`, `auto/N` or `auto` means where the environment's variables are as `variable` says. `auto` is the task of the array that
    /// Slurm or Kubernetes runs: `SLURM_ARRAY_TASK_ID` or `JOB_COMPLETION_INDEX`. Without N only Slurm tells how many there are, and
    /// only an array that begins at 0 and leaves nothing out can be counted.
    ///
    /// # Errors
    /// What is missing or wrong.
    pub fn parse(text: &str, variable: impl Fn(&str) -> Option<String>) -> Result<Self, ShardError> {
        let Some(rest) = text.strip_prefix("auto") else { return text.parse() };
        let told = match rest.strip_prefix('/') {
            Some(of) => Some(number("the number of shards", of)?),
            None if rest.is_empty() => None,
            None => return text.parse(),
        };
        let read = |name: &str| variable(name).map(|value| number(name, &value)).transpose();
        let count = read("SLURM_ARRAY_TASK_COUNT")?;
        match (read("SLURM_ARRAY_TASK_ID")?, read("JOB_COMPLETION_INDEX")?, told) {
            (Some(index), _, Some(of)) | (None, Some(index), Some(of)) => Self::new(index, of),
            (Some(index), _, None) => {
                let whole = count.filter(|count| {
                    read("SLURM_ARRAY_TASK_MIN") == Ok(Some(0))
                        && read("SLURM_ARRAY_TASK_MAX") == Ok(count.checked_sub(1))
                });
                let of = whole.ok_or_else(|| {
                    ShardError("this array does not begin at 0 or leaves numbers out: say how many shards there are, as in auto/16".into())
                })?;
                Self::new(index, of)
            }
            (None, Some(_), None) => Err(ShardError(
                "JOB_COMPLETION_INDEX does not tell of how many: give spec.completions, as in auto/16".into(),
            )),
            (None, None, _) => Err(ShardError(
                "neither SLURM_ARRAY_TASK_ID nor JOB_COMPLETION_INDEX is set: say which, as in 3/16".into(),
            )),
        }
    }
}

fn number(name: &str, text: &str) -> Result<u32, ShardError> {
    text.trim().parse().map_err(|_| ShardError(format!("{name}: {text:?} is no number of a shard")))
}

impl FromStr for Shard {
    type Err = ShardError;

    fn from_str(text: &str) -> Result<Self, ShardError> {
        let (index, of) = text
            .split_once('/')
            .ok_or_else(|| ShardError(format!("{text:?}: a shard is I/N, as in 3/16, or auto")))?;
        Self::new(number("shard", index)?, number("the number of shards", of)?)
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn with<'a>(variables: &'a [(&'a str, &'a str)]) -> impl Fn(&str) -> Option<String> + 'a {
        |name| variables.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_owned())
    }

    #[test]
    fn engines_say_which_task_it_is() {
        let slurm = [
            ("SLURM_ARRAY_TASK_ID", "2"),
            ("SLURM_ARRAY_TASK_COUNT", "4"),
            ("SLURM_ARRAY_TASK_MIN", "0"),
            ("SLURM_ARRAY_TASK_MAX", "3"),
        ];
        assert_eq!(Shard::parse("auto", with(&slurm)), Shard::new(2, 4));
        // One task again, of an array of sixteen.
        let again = [("SLURM_ARRAY_TASK_ID", "9"), ("SLURM_ARRAY_TASK_COUNT", "1")];
        assert_eq!(Shard::parse("auto/16", with(&again)), Shard::new(9, 16));
        assert!(Shard::parse("auto", with(&again)).unwrap_err().to_string().contains("auto/16"));
        let kubernetes = [("JOB_COMPLETION_INDEX", "3")];
        assert_eq!(Shard::parse("auto/8", with(&kubernetes)), Shard::new(3, 8));
        assert!(Shard::parse("auto", with(&kubernetes)).is_err());
        assert!(Shard::parse("auto/8", with(&[])).is_err());
        assert_eq!(Shard::parse("3/8", with(&[])), Shard::new(3, 8));
        for wrong in ["8/8", "0/0", "-1/4", "3", "a/b", "automatic", "auto/x", "1/2/3", ""] {
            assert!(Shard::parse(wrong, with(&slurm)).is_err(), "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn every_log_belongs_to_one_shard(of in 1u32..40, logs in 0usize..300) {
            for place in 0..logs {
                let holding = (0..of).filter(|i| Shard::new(*i, of).unwrap().holds(place)).count();
                prop_assert_eq!(holding, 1);
            }
        }

        #[test]
        fn any_text_is_a_shard_or_an_error(text in "\\PC{0,12}", value in "\\PC{0,6}") {
            if let Ok(shard) = Shard::parse(&text, |_| Some(value.clone())) {
                prop_assert!(shard.index() < shard.of());
            }
        }
    }
}
