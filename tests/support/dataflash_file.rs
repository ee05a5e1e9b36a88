//! DataFlash logs as ArduPilot would have written them, of the samples of a flight.
#![allow(clippy::expect_used, reason = "helpers of tests may fail like tests")]

use holdover::sample::{Airframe, FlowRotation, Sample, VehicleStatus};

use crate::flight::Step;
use crate::ulog_file::micros;

const FMT: u8 = 128;
/// Name, format and labels of what is written, as ArduPilot 4.7 has them.
const KINDS: [(&str, &str, &str); 17] = [
    ("IMU", "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"),
    ("MAG", "QBhhhhhhhhhBI", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S"),
    ("BARO", "QBffI", "TimeUS,I,Alt,Press,SMS"),
    ("GPS", "QBBIHBcLLeffffB", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U"),
    ("GPA", "QBCCCCfBIH", "TimeUS,I,VDop,HAcc,VAcc,SAcc,YAcc,VV,SMS,Delta"),
    ("OF", "QBffff", "TimeUS,Qual,flowX,flowY,bodyX,bodyY"),
    ("RFND", "QBfBBb", "TimeUS,Instance,Dist,Stat,Orient,Quality"),
    ("ARSP", "QBf", "TimeUS,I,Airspeed"),
    ("ARM", "QB", "TimeUS,ArmState"),
    ("MSG", "QZ", "TimeUS,Message"),
    ("GYR", "QBQfff", "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ"),
    ("ACC", "QBQfff", "TimeUS,I,SampleUS,AccX,AccY,AccZ"),
    ("EV", "QB", "TimeUS,Id"),
    ("STAT", "QBfBBB", "TimeUS,isFlying,isFlyProb,Armed,Safety,Crash"),
    ("ESC", "QBffffcfcf", "TimeUS,Instance,RPM,RawRPM,Volt,Curr,Temp,CTot,MotTemp,Err"),
    ("ISBH", "QHBBHHQf", "TimeUS,N,type,instance,mul,smp_cnt,SampleUS,smp_rate"),
    ("ISBD", "QHHaaa", "TimeUS,N,seqno,x,y,z"),
];

/// A file that grows.
pub struct DataFlashFile {
    pub bytes: Vec<u8>,
}

fn padded(text: &str, n: usize) -> Vec<u8> {
    let mut bytes = text.as_bytes().to_vec();
    bytes.resize(n, 0);
    bytes
}

fn size(format: &str) -> usize {
    let one = |letter| match letter {
        'Q' => 8,
        'f' | 'I' | 'L' | 'e' => 4,
        'h' | 'H' | 'c' | 'C' => 2,
        'Z' | 'a' => 64,
        _ => 1,
    };
    format.chars().map(one).sum()
}

impl DataFlashFile {
    /// The descriptions.
    pub fn new() -> Self {
        let mut file = Self { bytes: Vec::new() };
        for (kind, (name, format, labels)) in KINDS.iter().enumerate() {
            file.bytes.extend([0xA3, 0x95, FMT, kind as u8, 3 + size(format) as u8]);
            file.bytes.extend(padded(name, 4));
            file.bytes.extend(padded(format, 16));
            file.bytes.extend(padded(labels, 64));
        }
        file
    }

    /// A message: its numbers, in the order and with the factors of its format; 32 of an array.
    pub fn message(&mut self, name: &str, us: u64, values: &[f64]) {
        let (kind, (_, format, _)) =
            KINDS.iter().enumerate().find(|(_, k)| k.0 == name).expect("a kind that is described");
        self.bytes.extend([0xA3, 0x95, kind as u8]);
        self.bytes.extend(us.to_le_bytes());
        let letters = format.chars().skip(1).flat_map(|letter| match letter {
            'a' => std::iter::repeat_n('h', 32),
            other => std::iter::repeat_n(other, 1),
        });
        assert_eq!(letters.clone().count(), values.len(), "{name}");
        for (letter, value) in letters.zip(values) {
            match letter {
                'f' => self.bytes.extend((*value as f32).to_le_bytes()),
                'Q' => self.bytes.extend((*value as u64).to_le_bytes()),
                'I' => self.bytes.extend((*value as u32).to_le_bytes()),
                'L' => self.bytes.extend(((value * 1e7).round() as i32).to_le_bytes()),
                'e' => self.bytes.extend(((value * 100.0).round() as i32).to_le_bytes()),
                'h' => self.bytes.extend((value.round() as i16).to_le_bytes()),
                'H' => self.bytes.extend((value.round() as u16).to_le_bytes()),
                'c' | 'C' => self.bytes.extend(((value * 100.0).round() as u16).to_le_bytes()),
                _ => self.bytes.push(*value as u8),
            }
        }
    }

    /// A whole flight.
    pub fn of(steps: &[Step]) -> Self {
        let mut file = Self::new();
        let mut status = None;
        for step in steps {
            let us = micros(&step.samples[0]);
            if status.replace(step.status) != Some(step.status) {
                file.status(us, step.status);
            }
            step.samples.iter().for_each(|sample| file.sample(us, sample));
        }
        file
    }

    fn status(&mut self, us: u64, status: VehicleStatus) {
        let firmware = match status.airframe {
            Some(Airframe::FixedWing) => "ArduPlane V4.5.7 (0b517cfc)",
            _ => "ArduCopter V4.5.7 (2a3dc4b7)",
        };
        let kind = KINDS.iter().position(|k| k.0 == "MSG").expect("described");
        self.bytes.extend([0xA3, 0x95, kind as u8]);
        self.bytes.extend(us.to_le_bytes());
        self.bytes.extend(padded(firmware, 64));
        self.message("ARM", us, &[f64::from(status.armed == Some(true))]);
    }

    /// A sample that was logged at `us`.
    pub fn sample(&mut self, us: u64, sample: &Sample) {
        let at = micros(sample);
        let millis = at as f64 * 1e-3;
        match sample {
            Sample::Imu(s) => {
                let (w, f) = (s.angular_rate.raw(), s.specific_force.raw());
                let told = [0.0, w.x, w.y, w.z, f.x, f.y, f.z, 0.0, 0.0, 40.0, 1.0, 1.0, 1000.0, 1000.0];
                self.message("IMU", at, &told);
            }
            Sample::Mag(s) => {
                let b = s.field.raw() * 1e7;
                let told = [0.0, b.x, b.y, b.z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
                self.message("MAG", at, &told);
            }
            Sample::Pressure(s) => self.message("BARO", us, &[0.0, 0.0, s.pressure_pa, millis]),
            Sample::Flow(s) => {
                let [x, y] = match s.rotation {
                    FlowRotation::SensorGyro(gyro) => gyro,
                    _ => [f64::NAN; 2],
                };
                let told = [s.quality * 255.0, s.rate_xy[0], s.rate_xy[1], x, y];
                self.message("OF", at, &told);
            }
            Sample::Range(s) => self.message("RFND", at, &[0.0, s.distance_m, 4.0, 25.0, 100.0]),
            Sample::Airspeed(s) => self.message("ARSP", at, &[0.0, s.airspeed_mps]),
            Sample::Gnss(s) => {
                let p = s.position.expect("a fix");
                let v = s.ground_velocity.expect("a velocity");
                let (lat, lon) = (p.latitude_rad.to_degrees(), p.longitude_rad.to_degrees());
                let course = v.course_rad.to_degrees();
                let satellites = f64::from(s.satellites.unwrap_or(0));
                let told = [
                    0.0,
                    3.0,
                    0.0,
                    0.0,
                    satellites,
                    1.0,
                    lat,
                    lon,
                    p.height_m,
                    v.speed_mps,
                    course,
                    0.0,
                    0.0,
                    1.0,
                ];
                self.message("GPS", us, &told);
                let accuracy = [
                    0.0,
                    1.0,
                    s.horizontal_accuracy_m.unwrap_or(0.0),
                    s.vertical_accuracy_m.unwrap_or(0.0),
                    s.speed_accuracy_mps.unwrap_or(0.0),
                    0.0,
                    1.0,
                    millis,
                    200.0,
                ];
                self.message("GPA", us, &accuracy);
            }
            Sample::Landmark(_) => {}
        }
    }
}
