//! Screws: the axis line of a joint, and the rigid motion it makes.
//!
//! Murray, Li & Sastry, "A Mathematical Introduction to Robotic Manipulation" (1994), chapter 2: a
//! rotary joint about the line through `p` along `ω` moves points by `exp(ξ̂ θ)` = rotation `R = I
//! + sin θ ω̂ + (1 - cos θ) ω̂²` and translation `(I - R) p`; a linear joint along `v` by the
//! translation `v θ`.

use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3, Vector3};

/// A rigid motion.
pub type Motion = IsometryMatrix3<f64>;

/// The velocity of a rigid motion: of a point `x` it is `angular × x + linear`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Twist {
    pub angular: Vector3<f64>,
    pub linear: Vector3<f64>,
}

impl Twist {
    /// The same velocity seen from a frame placed by `motion` (the adjoint map).
    pub fn seen_from(&self, motion: &Motion) -> Self {
        let angular = motion.rotation * self.angular;
        let linear = motion.rotation * self.linear + motion.translation.vector.cross(&angular);
        Self { angular, linear }
    }
}

/// The rotation vector `r` as a motion about the point `p`, followed by the translation `t`.
pub fn small_motion(r: Vector3<f64>, p: Vector3<f64>, t: Vector3<f64>) -> Motion {
    let rotation = Rotation3::from_scaled_axis(r);
    Motion::from_parts(Translation3::from(p - rotation * p + t), rotation)
}

/// A unit rotary screw, with its powers kept for speed.
#[derive(Debug, Clone)]
pub struct RotaryScrew {
    pub direction: Vector3<f64>,
    pub point: Vector3<f64>,
    hat: Matrix3<f64>,
    hat2: Matrix3<f64>,
}

impl RotaryScrew {
    /// The screw about the line through `point` along the unit vector `direction`.
    pub fn new(direction: Vector3<f64>, point: Vector3<f64>) -> Self {
        let hat = direction.cross_matrix();
        Self { direction, point, hat, hat2: hat * hat }
    }

    /// The rotation by `angle_rad`.
    pub fn rotation(&self, angle_rad: f64) -> Matrix3<f64> {
        let (sin, cos) = angle_rad.sin_cos();
        Matrix3::identity() + self.hat * sin + self.hat2 * (1.0 - cos)
    }

    /// The motion by `angle_rad`.
    pub fn motion(&self, angle_rad: f64) -> Motion {
        let rotation = self.rotation(angle_rad);
        Motion::from_parts(
            Translation3::from(self.point - rotation * self.point),
            Rotation3::from_matrix_unchecked(rotation),
        )
    }

    /// Its velocity for a unit angular speed.
    pub fn twist(&self) -> Twist {
        Twist { angular: self.direction, linear: self.point.cross(&self.direction) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_screw_turns_about_its_own_line() {
        let screw = RotaryScrew::new(Vector3::y(), Vector3::new(1.0, 0.0, 2.0));
        let motion = screw.motion(std::f64::consts::FRAC_PI_2);
        // Ry(90°) turns -Z to -X: the point below the line comes to lie on its -X side.
        let moved = motion * nalgebra::Point3::new(1.0, 5.0, -1.0);
        assert!((moved.coords - Vector3::new(-2.0, 5.0, 2.0)).norm() < 1e-14);
    }

    #[test]
    fn the_adjoint_carries_velocities() {
        let screw = RotaryScrew::new(Vector3::z(), Vector3::new(3.0, -1.0, 0.0));
        let frame =
            small_motion(Vector3::new(0.3, -0.2, 0.5), Vector3::x(), Vector3::new(1.0, 2.0, 3.0));
        let h = 1e-6;
        let motion = |a: f64| frame * screw.motion(a) * frame.inverse();
        let x = nalgebra::Point3::new(0.4, 0.5, 0.6);
        let numeric = (motion(h) * x - motion(-h) * x) / (2.0 * h);
        let twist = screw.twist().seen_from(&frame);
        assert!((twist.angular.cross(&x.coords) + twist.linear - numeric).norm() < 1e-8);
    }
}
