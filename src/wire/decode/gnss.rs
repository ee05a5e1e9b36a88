//! GNSS receivers and the autopilot's origin.

use mavlink::dialects::ardupilotmega as apm;

use crate::geo::Geodetic;
use crate::sample::{GnssFix, GnssSample, GnssWarning, GroundVelocity, Input, Sample};
use crate::time::{AutopilotTime, Span};
use crate::wire::gnss_integrity;

use super::{Cause, Decoder, Out, Repair};

/// What GPS_RAW_INT and GPS2_RAW have in common.
#[derive(Clone, Copy, Debug)]
struct RawFix {
    time_usec: u64,
    fix: apm::GpsFixType,
    lat_lon_e7: [i32; 2],
    alt_mm: i32,
    vel_cms: u16,
    cog_cdeg: u16,
    acc_mm: [u32; 3],
    satellites: u8,
}

/// [`RawFix`] of either message: two types with the same fields.
macro_rules! raw {
    ($m:expr) => {
        RawFix {
            time_usec: $m.time_usec,
            fix: $m.fix_type,
            lat_lon_e7: [$m.lat, $m.lon],
            alt_mm: $m.alt,
            vel_cms: $m.vel,
            cog_cdeg: $m.cog,
            acc_mm: [$m.h_acc, $m.v_acc, $m.vel_acc],
            satellites: $m.satellites_visible,
        }
    };
}

impl RawFix {
    /// Whether it tells the same as another, whatever its stamp, accuracies and satellites.
    fn tells_what(&self, other: &Self) -> bool {
        let told = |f: &Self| (f.fix as u8, f.lat_lon_e7, f.alt_mm, f.vel_cms, f.cog_cdeg);
        told(self) == told(other)
    }
}

/// A stamp that stays the same for longer while the fix changes is none.
const CONSTANT: Span = Span::from_millis(1500);
/// Fixes without stamps that tell the same are one for so long.
const SAME_FIX: Span = Span::from_millis(200);

/// A warning that is not repeated is over after this: a receiver that says nothing more has not taken it back.
const WARNS_FOR: Span = Span::from_millis(30_000);

/// What the stamps of one receiver are worth, and what it warns of.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Receiver {
    /// The fix before, and when it was taken.
    last: Option<(RawFix, AutopilotTime)>,
    /// Since when the stamp has been what it is.
    stamp_since: Option<AutopilotTime>,
    /// What it warns of, and when it said so last.
    warning: Option<(GnssWarning, AutopilotTime)>,
}

impl Decoder {
    pub(super) fn gps_raw_int(&mut self, m: &apm::GPS_RAW_INT_DATA, out: Out<'_>) -> Result<(), Cause> {
        let raw = raw!(m);
        self.receiver(0, &raw, out)
    }

    pub(super) fn gps2_raw(&mut self, m: &apm::GPS2_RAW_DATA, out: Out<'_>) -> Result<(), Cause> {
        let raw = raw!(m);
        self.receiver(1, &raw, out)
    }

    /// GNSS_INTEGRITY: said with the receiver's next fix.
    pub(super) fn gnss_integrity(&mut self, payload: &[u8]) -> Result<(), Cause> {
        let (receiver, warning) = gnss_integrity::read(payload).ok_or(Cause::BadPayload)?;
        let now = self.now()?;
        if let Some(state) = self.receivers.get_mut(usize::from(receiver)) {
            state.warning = warning.map(|w| (w, now));
        }
        Ok(())
    }

    /// What a receiver warns of at present.
    fn warning(&self, receiver: u8, time: AutopilotTime) -> Option<GnssWarning> {
        let (warning, said) = self.receivers.get(usize::from(receiver))?.warning?;
        (time - said < WARNS_FOR).then_some(warning)
    }

    fn receiver(&mut self, receiver: u8, raw: &RawFix, out: Out<'_>) -> Result<(), Cause> {
        let fix = match raw.fix {
            apm::GpsFixType::GPS_FIX_TYPE_NO_GPS | apm::GpsFixType::GPS_FIX_TYPE_NO_FIX => GnssFix::None,
            apm::GpsFixType::GPS_FIX_TYPE_2D_FIX => GnssFix::TwoD,
            apm::GpsFixType::GPS_FIX_TYPE_3D_FIX => GnssFix::ThreeD,
            _ => GnssFix::Corrected,
        };
        // A lost receiver repeats its last stamp or sends zero: the word "no fix" is new all the same.
        let time = if fix == GnssFix::None { Some(self.now()?) } else { self.time_of_fix(receiver, raw)? };
        let Some(time) = time else { return Ok(()) };
        let position = (fix > GnssFix::None).then(|| position(raw.lat_lon_e7, raw.alt_mm)).transpose()?;
        let sample = GnssSample {
            time,
            receiver,
            fix,
            position,
            ground_velocity: position.and(velocity(raw.vel_cms, raw.cog_cdeg)),
            horizontal_accuracy_m: accuracy(raw.acc_mm[0]),
            vertical_accuracy_m: accuracy(raw.acc_mm[1]),
            speed_accuracy_mps: accuracy(raw.acc_mm[2]),
            satellites: (raw.satellites != u8::MAX).then_some(raw.satellites),
            warning: self.warning(receiver, time),
        };
        out.push(Input::Sample(Sample::Gnss(sample)));
        Ok(())
    }
}

impl Decoder {
    /// When a fix was measured; `None` for one that was sent before. The receiver's stamp where it is one on the autopilot's clock, else
    /// the newest time of the stream: PX4 stamps with 0 while the receiver tells no UTC, others with 1970 before the autopilot says what
    /// that is, or with the same for ever.
    fn time_of_fix(&mut self, receiver: u8, raw: &RawFix) -> Result<Option<AutopilotTime>, Cause> {
        let Ok(now) = self.now() else { return self.clock.usec(raw.time_usec).map(Some) };
        let state = &mut self.receivers[usize::from(receiver.min(1))];
        let last = state.last;
        let same_stamp = last.is_some_and(|(before, _)| before.time_usec == raw.time_usec);
        let since = *state.stamp_since.filter(|_| same_stamp).get_or_insert(now);
        state.stamp_since = Some(since);
        let repeated = last.filter(|(before, _)| before.tells_what(raw)).map(|(_, taken)| now - taken);
        let constant = same_stamp && now - since > CONSTANT && repeated.is_none();
        let usable = raw.time_usec != 0 && !constant && self.clock.foreign_usec(raw.time_usec).is_ok();
        if repeated.is_some_and(|age| if usable { same_stamp } else { age < SAME_FIX }) {
            self.repairs.count(Repair::GnssRepeated);
            return Ok(None);
        }
        self.receivers[usize::from(receiver.min(1))].last = Some((*raw, now));
        if usable {
            return self.clock.usec(raw.time_usec).map(Some);
        }
        self.repairs.count(Repair::GnssByArrival);
        Ok(Some(now))
    }
}

fn position(lat_lon_e7: [i32; 2], alt_mm: i32) -> Result<Geodetic, Cause> {
    let [lat, lon] = lat_lon_e7.map(|v| f64::from(v) * 1e-7);
    let height = f64::from(alt_mm) * 1e-3;
    // Exactly (0, 0) is what receivers and simulators send when they know nothing.
    if lat.abs() > 90.0
        || lon.abs() > 180.0
        || lat_lon_e7 == [0, 0]
        || !(-1000.0..=60_000.0).contains(&height)
    {
        return Err(Cause::Absurd);
    }
    Ok(Geodetic::from_degrees(lat, lon, height))
}

/// 65535 is "not known" in both fields.
fn velocity(vel_cms: u16, cog_cdeg: u16) -> Option<GroundVelocity> {
    (vel_cms != u16::MAX && cog_cdeg <= 36_000).then(|| GroundVelocity {
        speed_mps: f64::from(vel_cms) * 0.01,
        course_rad: (f64::from(cog_cdeg) * 0.01).to_radians(),
    })
}

/// 0 is "not known" (the extension was cut off or never filled).
fn accuracy(mm: u32) -> Option<f64> {
    (mm != 0 && mm != u32::MAX).then(|| f64::from(mm) * 1e-3)
}

pub(super) fn origin(m: &apm::GPS_GLOBAL_ORIGIN_DATA) -> Result<Geodetic, Cause> {
    position([m.latitude, m.longitude], m.altitude)
}
