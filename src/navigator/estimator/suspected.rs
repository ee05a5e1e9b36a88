//! What jumps that are only suspected may have done to what is published.
//!
//! While a window shows one, it is what the jump of that window would have moved the position by. When the window goes nothing shows it any more, and what
//! it has done stays: with p and v what it had moved position and velocity by and π its odds, the doubt D of both, 4 × 4, is
//!
//! D ← F D Fᵀ + π [p; v][p; v]ᵀ,  F = [I, I t; 0, I].
//!
//! The filter does not know of it: a mean that follows a suspicion would be wrong whenever that is.

use nalgebra::{Matrix2, Matrix4, Vector4};

use crate::filter::error_state::{JUMP_ONSET_PART, JumpWindow};
use crate::time::AutopilotTime;

/// See the module's documentation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Suspicion {
    shown: Matrix2<f64>,
    gone: Matrix4<f64>,
    /// When that was so.
    at: Option<AutopilotTime>,
}

impl Suspicion {
    /// The windows show this of the horizontal position, m².
    pub(super) fn show(&mut self, now: AutopilotTime, shown: Matrix2<f64>) {
        self.shown = shown;
        let dt = self.at.replace(now).map_or(0.0, |at| now.seconds_since(at).max(0.0));
        let mut moves = Matrix4::identity();
        (moves[(0, 2)], moves[(1, 3)]) = (dt, dt);
        self.gone = moves * self.gone * moves.transpose();
    }

    /// A window has gone that had shown a jump with these odds.
    pub(super) fn keep(&mut self, window: &JumpWindow, jump: usize, odds: f64) {
        let Some([p, v]) = window.moves(jump) else { return };
        let by = Vector4::new(p.x, p.y, v.x, v.y);
        self.gone += by * by.transpose() * odds;
    }

    /// A jump is believed that explains it: as well as such are known.
    pub(super) fn explain(&mut self) {
        self.gone *= JUMP_ONSET_PART * JUMP_ONSET_PART;
    }

    /// It is corrected, whatever it was.
    pub(super) fn forget(&mut self) {
        self.gone.fill(0.0);
    }

    /// Of the horizontal position, NE, m².
    pub(super) fn position(&self) -> Matrix2<f64> {
        self.shown + self.gone.fixed_view::<2, 2>(0, 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_gone_goes_on_as_it_moved_until_it_is_explained() {
        let at = |s: f64| AutopilotTime::from_micros((s * 1e6) as i64);
        let mut suspicion = Suspicion::default();
        suspicion.show(at(0.0), Matrix2::identity());
        let by = Vector4::new(3.0, 0.0, 0.0, 2.0);
        suspicion.gone = by * by.transpose() * 0.5;
        suspicion.show(at(4.0), Matrix2::identity());
        // Half of (3, 4 s · 2 m/s), beside what the windows show.
        let sure = suspicion.position() - Matrix2::identity();
        assert!((sure - Matrix2::new(4.5, 12.0, 12.0, 32.0)).norm() < 1e-9, "{sure}");
        suspicion.explain();
        assert!((suspicion.position()[(0, 0)] - 1.0 - 4.5 * JUMP_ONSET_PART.powi(2)).abs() < 1e-9);
        suspicion.forget();
        assert_eq!(suspicion.position(), Matrix2::identity());
    }
}
