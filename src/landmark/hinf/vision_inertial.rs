//! The paper's example: pose of a vehicle from an inertial navigation system and a camera that sees known points (Aguiar, Section V).
//!
//! Three frames: V, in which the points are known; I, in which the inertial system gives its pose (p, R_I); B, the body. The states are
//! x = [RᵀᵛP_I; vec(ᵛ_IRᵀ); ᴮQ1; vec(Rᵀ)] with R = ᵛ_BR, columns stacked, all of them turning against the body: 24. Without the inertial
//! system's pose the first twelve cannot be observed, and P loses definiteness: [`VisionInertial::camera_only`] drops them.
//!
//! The outputs, in the form E0(x)y − C(x) of (2):
//! - y1 = R_Iᵀp: C1 = [−I 0 −I ᵛQ1ᵀ⊗I],
//! - y2 = vec(R_Iᵀ): E0 = I₃⊗R_Iᵀ on the second block, C2 = [0 0 0 I₉],
//! - a point Q_i as the camera sees it, y with y₃ = 1: E0 = 0, E1 = 1, C = [0 0 FᶜR (Q_i − Q1)ᵀ⊗FᶜR] x + FᶜP_B.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::implicit::{AffineDynamics, AffineTransition, ImplicitOutput, ImplicitSystem};
use super::riccati::{self, Discount};
use crate::geo::kabsch_rotation;
use crate::geo::so3::hat;
use crate::landmark::motion::BodyMotion;

/// A camera on the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraModel {
    /// F, upper triangular: from camera axes (z along the optical axis) to the image.
    pub intrinsic: Matrix3<f64>,
    /// ᶜR: from body to camera axes.
    pub r_body_to_camera: Matrix3<f64>,
    /// ᶜP_B: the body's origin in camera axes, m.
    pub body_in_camera: Vector3<f64>,
}

/// The system of the paper's example. Frame V stands for "landmark frame" in names.
#[derive(Clone, Debug, PartialEq)]
pub struct VisionInertial {
    camera: CameraModel,
    landmarks: Vec<Vector3<f64>>,
    with_inertial: bool,
    /// Diagonal of GGᵀ for the four blocks.
    disturbance: [f64; 4],
}

/// What the example measures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum VisionSample {
    /// Pose of the body in I: position, m, and rotation.
    InertialPose {
        /// p, I, m.
        position: Vector3<f64>,
        /// R_I, from body to I.
        r_body_to_inertial: Matrix3<f64>,
    },
    /// Where a landmark is in the image, homogeneous (third component 1).
    Point {
        /// Index of the landmark.
        landmark: usize,
        /// ȳ.
        image: Vector3<f64>,
    },
}

/// Variance of every output: 1 in the paper.
const VARIANCE: f64 = 1.0;

/// First rows of the blocks when all are there.
const POSITION_I: usize = 0;
const ROTATION_I: usize = 3;
const POINT: usize = 12;
const ROTATION: usize = 15;

impl VisionInertial {
    /// All 24 states. `disturbance` has the diagonal of GGᵀ on RᵀᵛP_I, vec(ᵛ_IRᵀ), ᴮQ1 and vec(Rᵀ). `None` without landmarks.
    pub fn new(camera: CameraModel, landmarks: Vec<Vector3<f64>>, disturbance: [f64; 4]) -> Option<Self> {
        (!landmarks.is_empty()).then_some(Self { camera, landmarks, with_inertial: true, disturbance })
    }

    /// The last twelve states only: for a camera without the inertial system's pose.
    #[must_use]
    pub fn camera_only(self) -> Self {
        Self { with_inertial: false, ..self }
    }

    /// The states at a pose: of the body in the landmark frame, and of I in it (ignored by the camera-only form).
    pub fn state(
        &self,
        position: &Vector3<f64>,
        r_body_to_landmark: &Matrix3<f64>,
        inertial_position: &Vector3<f64>,
        r_inertial_to_landmark: &Matrix3<f64>,
    ) -> DVector<f64> {
        let mut x = DVector::zeros(24);
        let r_t = r_body_to_landmark.transpose();
        x.fixed_rows_mut::<3>(POSITION_I).copy_from(&(r_t * inertial_position));
        x.fixed_rows_mut::<9>(ROTATION_I).copy_from_slice(r_inertial_to_landmark.transpose().as_slice());
        x.fixed_rows_mut::<3>(POINT).copy_from(&(r_t * (self.first() - position)));
        x.fixed_rows_mut::<9>(ROTATION).copy_from_slice(r_t.as_slice());
        x.rows(self.offset(), self.dimension()).into()
    }

    /// The body's position in the landmark frame and its attitude ᵛ_BR out of a state, the nine numbers projected to a rotation. `None` when
    /// there is none near.
    pub fn pose(&self, x: &DVector<f64>) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        if x.len() != self.dimension() {
            return None;
        }
        let at = |i: usize| i - self.offset();
        let point = Vector3::from_column_slice(x.rows(at(POINT), 3).as_slice());
        let r_t = Matrix3::from_column_slice(x.rows(at(ROTATION), 9).as_slice());
        let r = kabsch_rotation(&r_t.transpose())?;
        Some((self.first() - r * point, r))
    }

    fn offset(&self) -> usize {
        if self.with_inertial { 0 } else { POINT }
    }

    fn first(&self) -> Vector3<f64> {
        self.landmarks.first().copied().unwrap_or_default()
    }

    /// The diagonal of GGᵀ.
    fn noise(&self) -> DVector<f64> {
        let block = |i: usize| match i {
            0..3 => 0,
            3..12 => 1,
            12..15 => 2,
            _ => 3,
        };
        DVector::from_fn(self.dimension(), |i, _| self.disturbance[block(i + self.offset())])
    }

    /// First rows of the 3 × 3 blocks that turn with the body.
    fn turning(&self) -> impl Iterator<Item = usize> + '_ {
        [POSITION_I, POINT, ROTATION, ROTATION + 3, ROTATION + 6]
            .into_iter()
            .filter_map(|i| i.checked_sub(self.offset()))
    }

    fn inertial_outputs(
        &self,
        position: &Vector3<f64>,
        r_body_to_inertial: &Matrix3<f64>,
        outputs: &mut Vec<ImplicitOutput>,
    ) {
        if !self.with_inertial {
            return;
        }
        let eye = Matrix3::identity();
        let r_t = r_body_to_inertial.transpose();
        let mut y1 = DMatrix::zeros(3, 24);
        y1.fixed_view_mut::<3, 3>(0, POSITION_I).copy_from(&eye);
        y1.fixed_view_mut::<3, 3>(0, POINT).copy_from(&eye);
        let mut y2 = DMatrix::zeros(9, 24);
        for i in 0..3 {
            y1.fixed_view_mut::<3, 3>(0, ROTATION + 3 * i).copy_from(&(-self.first()[i] * eye));
            y2.fixed_view_mut::<3, 3>(3 * i, ROTATION_I + 3 * i).copy_from(&r_t);
            y2.fixed_view_mut::<3, 3>(3 * i, ROTATION + 3 * i).copy_from(&-eye);
        }
        let constant = DVector::from_column_slice((r_t * position).as_slice());
        outputs.push(ImplicitOutput { gradient: y1, constant, free: None, variance: VARIANCE });
        let constant = DVector::zeros(9);
        outputs.push(ImplicitOutput { gradient: y2, constant, free: None, variance: VARIANCE });
    }

    fn point_output(&self, landmark: usize, image: &Vector3<f64>, outputs: &mut Vec<ImplicitOutput>) {
        let Some(point) = self.landmarks.get(landmark) else { return };
        let f_r = self.camera.intrinsic * self.camera.r_body_to_camera;
        let mut gradient = DMatrix::zeros(3, self.dimension());
        let at = |i: usize| i - self.offset();
        gradient.fixed_view_mut::<3, 3>(0, at(POINT)).copy_from(&-f_r);
        for i in 0..3 {
            let block = -(point - self.first())[i] * f_r;
            gradient.fixed_view_mut::<3, 3>(0, at(ROTATION) + 3 * i).copy_from(&block);
        }
        let offset = -(self.camera.intrinsic * self.camera.body_in_camera);
        outputs.push(ImplicitOutput {
            gradient,
            constant: DVector::from_column_slice(offset.as_slice()),
            free: Some(DMatrix::from_column_slice(3, 1, image.as_slice())),
            variance: VARIANCE,
        });
    }
}

impl ImplicitSystem for VisionInertial {
    type Input = BodyMotion;
    type Sample = VisionSample;

    fn dimension(&self) -> usize {
        24 - self.offset()
    }

    fn dynamics(&self, input: &BodyMotion) -> AffineDynamics {
        let n = self.dimension();
        let mut matrix = DMatrix::zeros(n, n);
        let skew = -hat(&input.angular_rate_body);
        for i in self.turning() {
            matrix.fixed_view_mut::<3, 3>(i, i).copy_from(&skew);
        }
        let mut constant = DVector::zeros(n);
        constant.fixed_rows_mut::<3>(POINT - self.offset()).copy_from(&-input.velocity_body);
        AffineDynamics { matrix, constant, disturbance: DMatrix::from_diagonal(&self.noise()) }
    }

    fn outputs(&self, sample: &VisionSample, _: &BodyMotion, outputs: &mut Vec<ImplicitOutput>) {
        match sample {
            VisionSample::InertialPose { position, r_body_to_inertial } => {
                self.inertial_outputs(position, r_body_to_inertial, outputs);
            }
            VisionSample::Point { landmark, image } => self.point_output(*landmark, image, outputs),
        }
    }

    fn transition(&self, input: &BodyMotion, dt_s: f64) -> AffineTransition {
        let n = self.dimension();
        let (turn, way) = input.over(dt_s);
        let mut matrix = DMatrix::identity(n, n);
        for i in self.turning() {
            matrix.fixed_view_mut::<3, 3>(i, i).copy_from(&turn.transpose());
        }
        let mut constant = DVector::zeros(n);
        constant.fixed_rows_mut::<3>(POINT - self.offset()).copy_from(&-turn.tr_mul(&way));
        AffineTransition { matrix, constant }
    }

    fn riccati_step(
        &self,
        input: &BodyMotion,
        discount: Discount,
        dt_s: f64,
        p: &DMatrix<f64>,
    ) -> Option<DMatrix<f64>> {
        let theta = self.transition(input, dt_s).matrix;
        riccati::skew_step(&theta, &self.noise(), &self.error_weight(), discount, dt_s, p)
    }
}
