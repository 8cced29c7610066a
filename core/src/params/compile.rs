//! Compiles parameters into the settings of the control tick.

use super::Params;
use super::table::ParameterId as P;
use crate::engine::command::Neutral;
use crate::engine::limit::Directions;
use crate::engine::pidf::Gains;
use crate::engine::settings::{
    Board, CurrentLimit, Derating, IndexSettings, LimitSettings, Policy, Settings, SlotSettings,
    SoftThreshold, Thresholds,
};
use crate::engine::throttle_law::{ThrottleGains, zone};
use crate::time::TICKS_PER_MS;

/// Identifiers of one slot's parameters.
struct SlotIds {
    p: P,
    i: P,
    d: P,
    zone: P,
    f: P,
    allowable: P,
    ramp: P,
    forward_max: P,
    reverse_max: P,
    forward_nominal: P,
    reverse_nominal: P,
}

const SLOT_0: SlotIds = SlotIds {
    p: P::Slot0P,
    i: P::Slot0I,
    d: P::Slot0D,
    zone: P::Slot0IZone,
    f: P::Slot0F,
    allowable: P::Slot0AllowableError,
    ramp: P::Slot0Ramp,
    forward_max: P::Slot0ForwardMax,
    reverse_max: P::Slot0ReverseMax,
    forward_nominal: P::Slot0ForwardNominal,
    reverse_nominal: P::Slot0ReverseNominal,
};

const SLOT_1: SlotIds = SlotIds {
    p: P::Slot1P,
    i: P::Slot1I,
    d: P::Slot1D,
    zone: P::Slot1IZone,
    f: P::Slot1F,
    allowable: P::Slot1AllowableError,
    ramp: P::Slot1Ramp,
    forward_max: P::Slot1ForwardMax,
    reverse_max: P::Slot1ReverseMax,
    forward_nominal: P::Slot1ForwardNominal,
    reverse_nominal: P::Slot1ReverseNominal,
};

/// Identifiers of one slot's parameters under the law in throttle units.
struct ThrottleSlotIds {
    p: P,
    i: P,
    d: P,
    f: P,
    zone: P,
    ramp: P,
}

const THROTTLE_SLOT_0: ThrottleSlotIds = ThrottleSlotIds {
    p: P::ThrottleSlot0P,
    i: P::ThrottleSlot0I,
    d: P::ThrottleSlot0D,
    f: P::ThrottleSlot0F,
    zone: P::ThrottleSlot0IZone,
    ramp: P::ThrottleSlot0Ramp,
};

const THROTTLE_SLOT_1: ThrottleSlotIds = ThrottleSlotIds {
    p: P::ThrottleSlot1P,
    i: P::ThrottleSlot1I,
    d: P::ThrottleSlot1D,
    f: P::ThrottleSlot1F,
    zone: P::ThrottleSlot1IZone,
    ramp: P::ThrottleSlot1Ramp,
};

fn throttle_slot(params: &Params, ids: &ThrottleSlotIds) -> ThrottleGains {
    ThrottleGains {
        p: params.get(ids.p),
        i: params.get(ids.i),
        d: params.get(ids.d),
        f: params.signed(ids.f),
        zone: zone(params.signed(ids.zone)),
        ramp: params.signed(ids.ramp),
    }
}

/// Everything the tick needs, from the parameters, the board and the driving dialect's policy.
#[must_use]
pub fn settings(params: &Params, board: &Board, policy: &Policy) -> Settings {
    Settings {
        policy: *policy,
        slots: [slot(params, &SLOT_0), slot(params, &SLOT_1)],
        throttle_slots: [
            throttle_slot(params, &THROTTLE_SLOT_0),
            throttle_slot(params, &THROTTLE_SLOT_1),
        ],
        current_limit: current_limit(params),
        limits: limits(params, policy),
        index: IndexSettings {
            clears_position: params.flag(P::ClearPositionOnIndex),
            rising: params.flag(P::IndexActiveEdge),
        },
        neutral: if params.flag(P::BrakeAtNeutral) {
            Neutral::Brake
        } else {
            Neutral::Coast
        },
        current_multiplier: params.signed(P::CurrentMultiplier),
        board: Board {
            thresholds: thresholds(&board.thresholds, policy),
            ..*board
        },
    }
}

fn limits(params: &Params, policy: &Policy) -> LimitSettings {
    let forward = begin(policy, params.signed(P::SoftForwardThreshold), 1);
    let reverse = begin(policy, params.signed(P::SoftReverseThreshold), -1);
    let both = |forward, reverse| Directions::new(params.flag(forward), params.flag(reverse));
    LimitSettings {
        normally_closed: both(P::ForwardLimitNormallyClosed, P::ReverseLimitNormallyClosed),
        switch_disabled: both(P::ForwardLimitDisabled, P::ReverseLimitDisabled),
        soft_enabled: both(P::SoftForwardEnable, P::SoftReverseEnable)
            .intersection(Directions::new(forward.is_some(), reverse.is_some())),
        clears_position: both(
            P::ClearPositionOnForwardLimit,
            P::ClearPositionOnReverseLimit,
        ),
        forward_threshold: forward.unwrap_or(i32::MAX),
        reverse_threshold: reverse.unwrap_or(i32::MIN),
    }
}

/// First position at which a soft limit acts, its direction being `sign`; nothing if there is none.
fn begin(policy: &Policy, threshold: i32, sign: i32) -> Option<i32> {
    match policy.soft_threshold {
        SoftThreshold::Inclusive => Some(threshold),
        SoftThreshold::Exclusive => threshold.checked_add(sign),
    }
}

/// The board's thresholds, with what the policy only shows.
fn thresholds(board: &Thresholds, policy: &Policy) -> Thresholds {
    match policy.indicated {
        None => *board,
        Some(shown) => Thresholds {
            under_voltage: shown.under_voltage,
            under_voltage_ticks: shown.ticks,
            over_temperature: shown.over_temperature,
            over_temperature_ticks: shown.ticks,
            derating: Derating::NONE,
            ..*board
        },
    }
}

/// An accumulator limit of 0 means none (guide, `paramClosedLoopIZoneSlot0`).
fn accumulator_limit(params: &Params, id: P) -> i32 {
    match params.signed(id) {
        0 => i32::MAX,
        limit => limit,
    }
}

fn slot(params: &Params, ids: &SlotIds) -> SlotSettings {
    SlotSettings {
        gains: Gains {
            p: params.signed(ids.p),
            i: params.signed(ids.i),
            d: params.signed(ids.d),
            f: params.signed(ids.f),
            accumulator_limit: accumulator_limit(params, ids.zone),
            allowable_error: params.signed(ids.allowable),
        },
        ramp: params.signed(ids.ramp),
        forward_max: params.signed(ids.forward_max),
        reverse_max: params.signed(ids.reverse_max),
        forward_nominal: params.signed(ids.forward_nominal),
        reverse_nominal: params.signed(ids.reverse_nominal),
    }
}

/// The guide's combinations of continuous limit, peak limit and peak duration in one threshold and one
/// delay: a continuous limit at or above the peak limit acts at once, otherwise the peak must last.
fn current_limit(params: &Params) -> CurrentLimit {
    let continuous = params.signed(P::ContinuousCurrent);
    let peak = params.signed(P::PeakCurrent);
    let (begin_above, begin_after_ticks) = if continuous >= peak {
        (continuous, 0)
    } else {
        (peak, params.get(P::PeakDuration) * TICKS_PER_MS)
    };
    CurrentLimit {
        enabled: params.flag(P::CurrentLimitEnable),
        begin_above,
        begin_after_ticks,
        continuous,
        gains: Gains {
            p: params.signed(P::CurrentLimitP),
            i: params.signed(P::CurrentLimitI),
            d: params.signed(P::CurrentLimitD),
            f: params.signed(P::CurrentLimitF),
            accumulator_limit: accumulator_limit(params, P::CurrentLimitIZone),
            allowable_error: 0,
        },
    }
}
