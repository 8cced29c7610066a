//! Brushed DC motor with its load, and the equations that tie it to the terminals.

/// A brushed DC motor and what its shaft carries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motor {
    /// Armature resistance in Ω.
    pub resistance: f64,
    /// Armature inductance in H.
    pub inductance: f64,
    /// Torque constant in N·m/A.
    pub torque_constant: f64,
    /// Back-EMF constant in V·s/rad.
    pub back_emf_constant: f64,
    /// Coulomb friction in N·m: opposes motion with a constant torque.
    pub coulomb_friction: f64,
    /// Viscous friction in N·m·s/rad.
    pub viscous_friction: f64,
    /// Moment of inertia of rotor and load in kg·m².
    pub inertia: f64,
}

impl Motor {
    /// A motor that reproduces the four numbers of a data sheet exactly.
    ///
    /// `voltage` in V, `free_speed` in rad/s, `free_current` and `stall_current` in A, `stall_torque`
    /// in N·m, `inductance` in H, `inertia` in kg·m². `coulomb_share` is the part of the free-running
    /// friction that does not depend on speed (0 to 1).
    ///
    /// Published curves count the friction: the shaft torque just above standstill is the
    /// electromagnetic torque minus Coulomb friction, and the free current balances all friction. The
    /// torque constant and the back-EMF constant are therefore found separately and differ a little
    /// (for the CIM by 13 %), where an ideal machine would have one constant for both.
    #[must_use]
    pub fn from_data_sheet(sheet: &DataSheet) -> Self {
        let resistance = sheet.voltage / sheet.stall_current;
        let torque_constant =
            sheet.stall_torque / (sheet.stall_current - sheet.coulomb_share * sheet.free_current);
        let friction = torque_constant * sheet.free_current;
        Self {
            resistance,
            inductance: sheet.inductance,
            torque_constant,
            back_emf_constant: (sheet.voltage - sheet.free_current * resistance) / sheet.free_speed,
            coulomb_friction: sheet.coulomb_share * friction,
            viscous_friction: (1.0 - sheet.coulomb_share) * friction / sheet.free_speed,
            inertia: sheet.inertia,
        }
    }
}

impl Default for Motor {
    /// The CIM of [`DataSheet::default`].
    fn default() -> Self {
        Self::from_data_sheet(&DataSheet::default())
    }
}

/// What a motor's data sheet says, see [`Motor::from_data_sheet`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DataSheet {
    /// Voltage of all other figures in V.
    pub voltage: f64,
    /// Speed without load in rad/s.
    pub free_speed: f64,
    /// Current without load in A.
    pub free_current: f64,
    /// Current at standstill in A.
    pub stall_current: f64,
    /// Shaft torque at standstill in N·m.
    pub stall_torque: f64,
    /// Part of the free-running friction that does not depend on speed.
    pub coulomb_share: f64,
    /// Armature inductance in H.
    pub inductance: f64,
    /// Moment of inertia of rotor and load in kg·m².
    pub inertia: f64,
}

impl Default for DataSheet {
    /// A CIM with a light flywheel.
    ///
    /// - 12 V, 5330 rpm, 2.7 A, 131 A, 2.41 N·m: the curve that is published for the CIM (FR801-001) by
    ///   its FRC suppliers.
    /// - 59 µH and 7.5·10⁻⁵ kg·m² for the rotor: figures in use among FRC teams (Chief Delphi threads on
    ///   modelling the CIM); the electrical time constant becomes 0.64 ms.
    /// - Load: an aluminium disc of 150 g and 50 mm radius, ½·m·r² = 1.9·10⁻⁴ kg·m² (chosen: the
    ///   mechanical time constant becomes 62 ms, fast enough to watch a velocity loop settle).
    /// - 60 % of the friction from brushes and bearings without regard to speed (chosen).
    fn default() -> Self {
        const ROTOR_INERTIA: f64 = 7.5e-5;
        const DISC_INERTIA: f64 = 0.5 * 0.150 * 0.050 * 0.050;
        Self {
            voltage: 12.0,
            free_speed: 5330.0 * core::f64::consts::TAU / 60.0,
            free_current: 2.7,
            stall_current: 131.0,
            stall_torque: 2.41,
            coulomb_share: 0.6,
            inductance: 59e-6,
            inertia: ROTOR_INERTIA + DISC_INERTIA,
        }
    }
}

/// How the terminals are driven during one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Terminals {
    /// A source of this voltage (V) behind this resistance (Ω); a short circuit is 0 V.
    Source { voltage: f64, resistance: f64 },
    /// Floating: the current flows through the free-wheeling diodes against this voltage (V) until it
    /// has died.
    Floating { against: f64 },
}

/// What acts on the shaft from outside.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Load {
    /// Torque against forward rotation in N·m, whichever way the shaft turns (a weight on a rope).
    pub(crate) torque: f64,
    /// The shaft is locked.
    pub(crate) locked: bool,
}

/// Motion and current of a motor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct MotorState {
    /// Armature current in A, positive from M+ to M−.
    pub(crate) current: f64,
    /// Angular velocity in rad/s, positive forward.
    pub(crate) speed: f64,
    /// Angle travelled in the latest step in rad.
    pub(crate) travel: f64,
}

/// A motor ready to be integrated with a fixed step.
///
/// The trapezoidal rule on the coupled equations
/// `L·di/dt = u − R·i − Ke·ω` and `J·dω/dt = Kt·i − b·ω − τ` is implicit in closed form: stable for any
/// step, of second order, exact at rest, and made of additions, multiplications and two divisions only,
/// so that a run gives the same bits on every machine (an exponential from the system's mathematics
/// library does not).
#[derive(Clone, Copy, Debug)]
pub(crate) struct MotorStep {
    motor: Motor,
    /// Half a step in s.
    half: f64,
    half_per_inductance: f64,
    half_per_inertia: f64,
}

impl MotorStep {
    /// Steps of `step` seconds.
    pub(crate) fn new(motor: Motor, step: f64) -> Self {
        let half = step / 2.0;
        Self {
            motor,
            half,
            half_per_inductance: half / motor.inductance,
            half_per_inertia: half / motor.inertia,
        }
    }

    /// One step.
    pub(crate) fn advance(&self, state: &mut MotorState, terminals: Terminals, load: Load) {
        let friction = self.friction(state, load);
        match terminals {
            Terminals::Source {
                voltage,
                resistance,
            } => {
                let total = self.motor.resistance + resistance;
                match friction {
                    Some(torque) => self.turn(state, voltage, total, torque),
                    None => self.rest(state, voltage, total),
                }
            }
            Terminals::Floating { against } => {
                self.free_wheel(state, against);
                self.spin(state, friction);
            }
        }
    }

    /// The torque against forward rotation from load and Coulomb friction; `None` if the shaft stays
    /// where it is.
    fn friction(&self, state: &MotorState, load: Load) -> Option<f64> {
        if load.locked {
            return None;
        }
        let coulomb = self.motor.coulomb_friction;
        if state.speed != 0.0 {
            return Some(load.torque + coulomb * state.speed.signum());
        }
        let drive = self.motor.torque_constant * state.current - load.torque;
        (drive.abs() > coulomb).then(|| load.torque + coulomb * drive.signum())
    }

    /// Both equations.
    fn turn(&self, state: &mut MotorState, voltage: f64, resistance: f64, torque: f64) {
        let motor = &self.motor;
        let (electric, mechanic) = (self.half_per_inductance, self.half_per_inertia);
        let right_current = state.current
            + electric
                * (2.0 * voltage
                    - resistance * state.current
                    - motor.back_emf_constant * state.speed);
        let right_speed = state.speed
            + mechanic
                * (motor.torque_constant * state.current
                    - motor.viscous_friction * state.speed
                    - 2.0 * torque);
        let left_current = 1.0 + electric * resistance;
        let left_speed = 1.0 + mechanic * motor.viscous_friction;
        let emf = electric * motor.back_emf_constant;
        let drive = mechanic * motor.torque_constant;
        let scale = 1.0 / (left_current * left_speed + emf * drive);
        state.current = (right_current * left_speed - emf * right_speed) * scale;
        self.settle(
            state,
            (left_current * right_speed + drive * right_current) * scale,
        );
    }

    /// The electrical equation alone, the shaft at rest.
    fn rest(&self, state: &mut MotorState, voltage: f64, resistance: f64) {
        let electric = self.half_per_inductance;
        state.current = (state.current + electric * (2.0 * voltage - resistance * state.current))
            / (1.0 + electric * resistance);
        state.speed = 0.0;
        state.travel = 0.0;
    }

    /// The current of floating terminals dies against the bus voltage.
    fn free_wheel(&self, state: &mut MotorState, against: f64) {
        let drop = 2.0 * self.half_per_inductance * against;
        state.current -= state.current.clamp(-drop, drop);
    }

    /// The mechanical equation alone.
    fn spin(&self, state: &mut MotorState, friction: Option<f64>) {
        let Some(torque) = friction else {
            state.speed = 0.0;
            state.travel = 0.0;
            return;
        };
        let mechanic = self.half_per_inertia;
        let viscous = self.motor.viscous_friction;
        let push = self.motor.torque_constant * state.current - torque;
        let next = (state.speed + mechanic * (2.0 * push - viscous * state.speed))
            / (1.0 + mechanic * viscous);
        self.settle(state, next);
    }

    /// Takes over the new speed; a shaft that would change its direction stops first, and the next
    /// step judges whether anything sets it in motion again.
    fn settle(&self, state: &mut MotorState, next: f64) {
        let next = if state.speed * next < 0.0 { 0.0 } else { next };
        state.travel = self.half * (state.speed + next);
        state.speed = next;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f64 = 250e-6;

    fn run(terminals: Terminals, load: Load, seconds: f64, state: &mut MotorState) {
        let motor = MotorStep::new(Motor::default(), STEP);
        for _ in 0..(seconds / STEP) as usize {
            motor.advance(state, terminals, load);
        }
    }

    const TWELVE_VOLTS: Terminals = Terminals::Source {
        voltage: 12.0,
        resistance: 0.0,
    };
    const SHORTED: Terminals = Terminals::Source {
        voltage: 0.0,
        resistance: 0.0,
    };

    fn near(value: f64, expected: f64, relative: f64) {
        let off = (value / expected - 1.0).abs();
        assert!(off < relative, "{value} is not {expected}");
    }

    #[test]
    fn free_speed_and_free_current_are_the_data_sheets() {
        let mut state = MotorState::default();
        run(TWELVE_VOLTS, Load::default(), 2.0, &mut state);
        near(state.speed * 60.0 / core::f64::consts::TAU, 5330.0, 0.001);
        near(state.current, 2.7, 0.001);
    }

    #[test]
    fn stall_current_is_the_data_sheets() {
        let mut state = MotorState::default();
        let locked = Load {
            torque: 0.0,
            locked: true,
        };
        run(TWELVE_VOLTS, locked, 0.1, &mut state);
        near(state.current, 131.0, 0.001);
        assert!(state.speed.abs() < f64::EPSILON);
    }

    #[test]
    fn stall_torque_is_what_a_weight_must_pull_to_stop_the_shaft() {
        let creeping = |torque| {
            let mut state = MotorState::default();
            run(
                TWELVE_VOLTS,
                Load {
                    torque,
                    locked: false,
                },
                1.0,
                &mut state,
            );
            state.speed
        };
        assert!(creeping(2.41 * 0.995) > 0.1);
        assert!(creeping(2.41 * 1.005) < 0.1);
    }

    #[test]
    fn current_rises_with_the_electrical_time_constant() {
        // Locked: i(t) = U/R·(1 − e^(−t·R/L)), exact at every step within 1 % of the final value.
        let motor = Motor::default();
        let step = MotorStep::new(motor, STEP);
        let mut state = MotorState::default();
        let locked = Load {
            torque: 0.0,
            locked: true,
        };
        for count in 1..20 {
            step.advance(&mut state, TWELVE_VOLTS, locked);
            let time = f64::from(count) * STEP;
            let exact = 131.0 * (1.0 - (-time * motor.resistance / motor.inductance).exp());
            assert!((state.current - exact).abs() < 1.31, "{count}");
        }
    }

    #[test]
    fn the_coarse_step_agrees_with_a_fine_one() {
        let fine = MotorStep::new(Motor::default(), STEP / 100.0);
        let coarse = MotorStep::new(Motor::default(), STEP);
        let (mut exact, mut state) = (MotorState::default(), MotorState::default());
        for count in 0..400 {
            for _ in 0..100 {
                fine.advance(&mut exact, TWELVE_VOLTS, Load::default());
            }
            coarse.advance(&mut state, TWELVE_VOLTS, Load::default());
            assert!((state.speed - exact.speed).abs() < 558.0 * 0.002, "{count}");
        }
    }

    #[test]
    fn a_shorted_motor_stops_long_before_a_floating_one() {
        let spinning = MotorState {
            speed: 500.0,
            ..MotorState::default()
        };
        let (mut braked, mut coasting) = (spinning, spinning);
        let floating = Terminals::Floating { against: 14.0 };
        run(SHORTED, Load::default(), 0.2, &mut braked);
        run(floating, Load::default(), 0.2, &mut coasting);
        assert!(braked.speed < 50.0, "{}", braked.speed);
        assert!(coasting.speed > 400.0, "{}", coasting.speed);
        assert!(coasting.current.abs() < f64::EPSILON);
        // Both come to a complete rest in the end and stay there.
        run(floating, Load::default(), 60.0, &mut coasting);
        assert!(coasting.speed.abs() < f64::EPSILON);
    }

    #[test]
    fn static_friction_holds_a_small_load_and_not_a_large_one() {
        let friction = Motor::default().coulomb_friction;
        let hanging = |torque| {
            let mut state = MotorState::default();
            let floating = Terminals::Floating { against: 14.0 };
            run(
                floating,
                Load {
                    torque,
                    locked: false,
                },
                0.5,
                &mut state,
            );
            state.speed
        };
        assert!(hanging(friction * 0.9).abs() < f64::EPSILON);
        assert!(hanging(friction * 1.1) < -1.0);
    }
}
