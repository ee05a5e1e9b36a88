//! The altimeters against each other in Monte Carlo runs. Shared by the tests and the `paper_altimeter` example.
#![allow(dead_code, reason = "the tests and the example each use their part")]

pub mod detection;
pub mod oracle;
pub mod score;

use holdover::altimeter::HeightVerdict;
use holdover::altimeter::{
    Altimeter, AltimeterMethod, AltimeterScheme, AltimeterSettings, Channel, ErrorModel, PublishedAltimeter,
};
use holdover::sim::altimeter::{AltimeterRun, AltimeterStep, FaultCase, FaultSize, STEP_S};

use detection::Detection;
use oracle::{OnBias, Oracle};
use score::Score;

/// The order of the schemes in every list.
pub const SCHEMES: [(AltimeterScheme, &str); 3] =
    [(AltimeterScheme::Ibi, "ibi"), (AltimeterScheme::Iig, "iig"), (AltimeterScheme::Ibig, "ibig")];

/// Who competes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    Published(AltimeterMethod),
    /// The project's own.
    Default,
    Oracle(OnBias),
}

impl Filter {
    /// The rows of the table.
    pub const ALL: [Self; 6] = [
        Self::Published(AltimeterMethod::Okf),
        Self::Published(AltimeterMethod::Rkf),
        Self::Published(AltimeterMethod::RkfJoseph),
        Self::Published(AltimeterMethod::Selector),
        Self::Default,
        Self::Oracle(OnBias::Estimate),
    ];

    pub fn label(&self) -> &'static str {
        match self {
            Self::Published(AltimeterMethod::Okf) => "okf",
            Self::Published(AltimeterMethod::Rkf) => "rkf",
            Self::Published(AltimeterMethod::RkfJoseph) => "rkf_joseph",
            Self::Published(AltimeterMethod::Selector) => "selector",
            Self::Default => "default",
            Self::Oracle(_) => "oracle",
        }
    }

    fn contestant(&self, model: ErrorModel) -> Box<dyn Contestant> {
        match *self {
            Self::Published(method) => Box::new(Published {
                altimeter: PublishedAltimeter::new(model, method),
                selects: method == AltimeterMethod::Selector,
            }),
            Self::Default => Box::new(Joint::new(|| Altimeter::new(AltimeterSettings::table_1()))),
            Self::Oracle(on_bias) => Box::new(Joint::new(|| Oracle::new(model, on_bias))),
        }
    }
}

/// What a filter says after a step, by [`SCHEMES`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Said {
    /// ΔH, m.
    pub delta_h: [f64; 3],
    /// The weights that the barometer's and the GNSS measurement had, where it has weights and there were measurements.
    pub weights: [[Option<f64>; 2]; 3],
    /// Whether it holds the barometer and GNSS for faulty, if it has an opinion.
    pub alarms: Option<[bool; 2]>,
}

/// A filter in a run. What is wrong is in the step: only the oracle looks.
trait Contestant {
    fn step(&mut self, step: &AltimeterStep) -> Said;
}

struct Published {
    altimeter: PublishedAltimeter,
    selects: bool,
}

impl Contestant for Published {
    fn step(&mut self, step: &AltimeterStep) -> Said {
        let report = self.altimeter.step(STEP_S, step.z_ibi, step.z_iig);
        let [ibi, iig] = [report.ibi, report.iig].map(|i| i.map(|i| i.prob));
        Said {
            delta_h: SCHEMES.map(|(scheme, _)| self.altimeter.estimate(scheme).delta_h_m),
            weights: [[ibi, None], [None, iig], [ibi, iig]],
            alarms: self.selects.then(|| self.altimeter.faulty().into()),
        }
    }
}

/// What a filter that uses both channels at once says after a step.
struct JointSaid {
    delta_h: f64,
    weights: [Option<f64>; 2],
    alarms: Option<[bool; 2]>,
}

/// A filter that uses both channels at once. Its `ibi` and `iig` are the same filter with the other channel missing.
trait JointFilter {
    fn step(&mut self, step: &AltimeterStep) -> JointSaid;
}

struct Joint<F>([F; 3]);

impl<F: JointFilter> Joint<F> {
    fn new(filter: impl Fn() -> F) -> Self {
        Self(std::array::from_fn(|_| filter()))
    }
}

impl<F: JointFilter> Contestant for Joint<F> {
    fn step(&mut self, step: &AltimeterStep) -> Said {
        let of = [AltimeterStep { z_iig: None, ..*step }, AltimeterStep { z_ibi: None, ..*step }, *step];
        let mut said = Said::default();
        for (i, (filter, step)) in self.0.iter_mut().zip(&of).enumerate() {
            let one = filter.step(step);
            (said.delta_h[i], said.weights[i], said.alarms) = (one.delta_h, one.weights, one.alarms);
        }
        said
    }
}

/// The direct form of the same problem: without any acceleration the height is −ΔH, and what the channels measure of it is −z.
impl JointFilter for Altimeter {
    fn step(&mut self, step: &AltimeterStep) -> JointSaid {
        self.predict(STEP_S, 0.0, 0.0);
        let channels = [(Channel::Baro, step.z_ibi), (Channel::Gnss, step.z_iig)];
        let weights = channels.map(|(channel, z)| {
            z.map(|z| match self.measure(channel, -z, None, 0.0) {
                HeightVerdict::Used { weight, .. } => weight,
                HeightVerdict::Rejected(_) => 0.0,
            })
        });
        JointSaid {
            delta_h: -self.height_m().unwrap_or(0.0),
            weights,
            alarms: Some(channels.map(|(channel, _)| self.health(channel).is_faulty())),
        }
    }
}

impl JointFilter for Oracle {
    fn step(&mut self, step: &AltimeterStep) -> JointSaid {
        Oracle::step(self, step);
        JointSaid { delta_h: self.delta_h(), weights: [None; 2], alarms: None }
    }
}

/// What a filter did with a case.
#[derive(Clone, Copy, Debug, Default)]
pub struct Outcome {
    /// Errors, by [`SCHEMES`].
    pub scores: [Score; 3],
    /// Alarms with both channels, from a filter that gives any.
    pub detection: Option<Detection>,
}

/// The runs of one seed with one size of faults.
#[derive(Clone, Copy, Debug)]
pub struct MonteCarlo {
    pub seed: u64,
    pub runs: u32,
    pub size: FaultSize,
}

impl MonteCarlo {
    /// A filter over the runs of a case.
    pub fn outcome(&self, case: FaultCase, filter: Filter) -> Outcome {
        let model = ErrorModel::table_1();
        let mut outcome = Outcome::default();
        for number in 0..self.runs {
            let run = AltimeterRun::draw(&model, case, self.size, self.seed, number);
            let mut contestant = filter.contestant(model);
            let said: Vec<Said> = run.steps.iter().map(|s| contestant.step(s)).collect();
            for (i, score) in outcome.scores.iter_mut().enumerate() {
                let errors: Vec<f64> =
                    run.steps.iter().zip(&said).map(|(t, s)| s.delta_h[i] - t.truth[0]).collect();
                let weights: Vec<_> = said.iter().map(|s| s.weights[i]).collect();
                score.add(&run, &errors, &weights);
            }
            let alarms: Vec<[bool; 2]> = said.iter().filter_map(|s| s.alarms).collect();
            if alarms.len() == run.steps.len() {
                outcome.detection.get_or_insert_default().add(&run, &alarms);
            }
        }
        outcome
    }

    /// The score of the fused altitude.
    pub fn fused(&self, case: FaultCase, filter: Filter) -> Score {
        self.outcome(case, filter).scores[2]
    }
}
