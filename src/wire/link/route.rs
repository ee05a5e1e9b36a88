//! Which link the autopilot is answered on, where several lead to it.

use super::LinkId;
use crate::time::{Companion, Span, Stamp};

/// Follows the link on which the autopilot is heard, and stays with it while it is heard there.
#[derive(Clone, Copy, Debug)]
pub struct ReplyRoute {
    patience: Span,
    current: Option<(LinkId, Stamp<Companion>)>,
}

impl ReplyRoute {
    /// Changes to another link after so long without the autopilot on the current one.
    pub fn new(patience: Span) -> Self {
        Self { patience, current: None }
    }

    /// Takes note that the autopilot was heard on `link`. True if replies go to another link than before.
    pub fn heard(&mut self, link: LinkId, now: Stamp<Companion>) -> bool {
        match &mut self.current {
            Some((current, heard)) if *current == link => {
                *heard = now;
                false
            }
            Some((_, heard)) if now - *heard <= self.patience => false,
            _ => {
                self.current = Some((link, now));
                true
            }
        }
    }

    /// The link to answer on.
    pub fn link(&self) -> Option<LinkId> {
        self.current.map(|(link, _)| link)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stays_with_a_link_while_the_autopilot_is_heard_there() {
        let at = |ms: i64| Stamp::from_micros(ms * 1000);
        let mut route = ReplyRoute::new(Span::from_millis(3000));
        assert_eq!(route.link(), None);
        assert!(route.heard(LinkId(1), at(0)));
        assert!(!route.heard(LinkId(0), at(10)));
        assert!(!route.heard(LinkId(1), at(1000)));
        assert!(!route.heard(LinkId(0), at(4000)));
        assert_eq!(route.link(), Some(LinkId(1)));
        assert!(route.heard(LinkId(0), at(4001)));
        assert_eq!(route.link(), Some(LinkId(0)));
    }
}
