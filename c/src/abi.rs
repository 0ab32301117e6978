//! The functions of `include/cdcr.h`, which documents them. A test compares their signatures.
//!
//! All unsafe code of this crate is here. A function converts pointers to values with `read_*`, calls the
//! rest of the crate, and writes results with `Out`. All rely on the pointer rule of `cdcr.h`: a pointer
//! other than NULL refers to memory of its type, with as many elements as the count beside it. Nobody else
//! changes that memory during the call. The types are numbers without padding: all bits are valid.

#![allow(
    unsafe_code,
    reason = "the border to C; the other files of this crate have none"
)]

use core::ffi::{CStr, c_char, c_int};
use core::time::Duration;

use cdcr_client::{CommandedRates, Connection, Driver, Requester, monotonic_ns};
use cdcr_shared_types::codes::{ChunkMode, EventKind, Interpolation, ObstacleAction, RequestKind};
use cdcr_shared_types::limits::{CABLES_MAX, CHUNK_POINTS_MAX, OBSTACLES_MAX};
use cdcr_shared_types::{
    Header, InputEvent, Location, Measurement, Obstacle, ReferencePoint, Response,
    RobotDescription, Status, Telemetry,
};

use crate::code::Code;
use crate::failure::{Failure, check_pointer, read_code, read_interface};
use crate::guard::{call, last_error, set_last_error};
use crate::handles;
use crate::layout::{Place, Position, Rates, Update, check_layout};
use crate::place::locate;
use crate::session::{Session, send_cable_lengths};

/// Memory of the caller for results, or NULL for none.
struct Out<T> {
    pointer: *mut T,
    capacity: usize,
}

impl<T> Out<T> {
    /// # Safety
    /// The pointer rule at the top of this file.
    unsafe fn array(pointer: *mut T, capacity: usize, name: &str) -> Result<Self, Failure> {
        check_pointer(pointer, name)?;
        Ok(Self { pointer, capacity })
    }

    /// # Safety
    /// As `array`.
    unsafe fn one(pointer: *mut T, name: &str) -> Result<Self, Failure> {
        // SAFETY: the caller keeps the rule.
        unsafe { Self::array(pointer, 1, name) }
    }

    /// For an optional result: NULL is not an error.
    ///
    /// # Safety
    /// As `array`.
    unsafe fn one_or_none(pointer: *mut T, name: &str) -> Result<Self, Failure> {
        if pointer.is_null() {
            let capacity = 0;
            return Ok(Self { pointer, capacity });
        }
        // SAFETY: the caller keeps the rule.
        unsafe { Self::one(pointer, name) }
    }

    fn write(&self, value: T) {
        self.write_at(0, value);
    }

    /// Writes the result, if there is one.
    fn write_result(&self, found: Result<T, Failure>) -> Result<(), Failure> {
        found.map(|value| self.write(value))
    }

    fn write_at(&self, index: usize, value: T) {
        if index < self.capacity {
            // SAFETY: inside the array, by the rule on pointers that `array` relies on.
            let element = unsafe { self.pointer.add(index) };
            // SAFETY: aligned, and memory for a `T`, by the same rule.
            unsafe { element.write(value) };
        }
    }
}

/// Reads a value behind a pointer.
///
/// # Safety
/// The pointer rule at the top of this file.
unsafe fn read<T: Copy>(pointer: *const T, name: &str) -> Result<T, Failure> {
    // SAFETY: the caller keeps the rule; one element.
    Ok(unsafe { read_array(pointer, 1, 1, name)? }[0])
}

/// The `count` elements of an array, at most `most`. NULL is the empty array.
///
/// # Safety
/// The pointer rule at the top of this file.
unsafe fn read_array<'a, T: Copy>(
    pointer: *const T,
    count: usize,
    most: usize,
    name: &str,
) -> Result<&'a [T], Failure> {
    if count > most {
        let why = format!("{name} has {count} elements, and {most} are the most");
        return Err(Failure::argument(why));
    }
    if count == 0 {
        return Ok(&[]);
    }
    check_pointer(pointer, name)?;
    // SAFETY: not NULL, aligned, of limited size, with `count` elements that nobody changes, by the caller's
    // rule.
    Ok(unsafe { core::slice::from_raw_parts(pointer, count) })
}

/// A text, or `None` for NULL.
///
/// # Safety
/// `text` is NULL or ends with a zero, and nobody changes it during the call.
unsafe fn read_text<'a>(text: *const c_char, name: &str) -> Result<Option<&'a str>, Failure> {
    if text.is_null() {
        return Ok(None);
    }
    // SAFETY: not NULL; the caller ensures the rest.
    let text = unsafe { CStr::from_ptr(text) };
    let unreadable = |_| Failure::argument(format!("{name} is not UTF-8: {text:?}"));
    text.to_str().map(Some).map_err(unreadable)
}

/// Location and robot. NULL is replaced by the environment variable, or the default.
///
/// # Safety
/// The pointer rule at the top of this file, for `place` and its strings.
unsafe fn read_place(place: *const Place) -> Result<(Location, String), Failure> {
    let (mut robot, mut prefix, mut root) = (None, None, None);
    if !place.is_null() {
        // SAFETY: the caller keeps the rule.
        let place = unsafe { read(place, "place")? };
        // SAFETY: as before.
        robot = unsafe { read_text(place.robot, "place.robot")? };
        // SAFETY: as before.
        prefix = unsafe { read_text(place.prefix, "place.prefix")? };
        // SAFETY: as before.
        root = unsafe { read_text(place.root, "place.root")? };
    }
    locate(robot, prefix, root)
}

fn ns(timeout_ns: u64) -> Duration {
    Duration::from_nanos(timeout_ns)
}

/// Writes the answer to a request, also if it is a refusal.
fn answer(asked: Result<Response, Failure>, response: &Out<Response>) -> Result<(), Failure> {
    let refusal = |failure: &Failure| failure.refusal;
    if let Some(answer) = asked.as_ref().map_or_else(refusal, |answer| Some(*answer)) {
        response.write(answer);
    }
    asked.map(drop)
}

#[unsafe(no_mangle)]
extern "C" fn cdcr_monotonic_ns() -> u64 {
    monotonic_ns()
}

#[unsafe(no_mangle)]
extern "C" fn cdcr_last_error() -> *const c_char {
    last_error()
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_stop(place: *const Place) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let (location, robot) = unsafe { read_place(place)? };
        Ok(Requester::stop(&location, &robot).map(drop)?)
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_connect(
    layout: u64,
    place: *const Place,
    timeout_ns: u64,
    connection: *mut *mut Session,
) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let handle = unsafe { Out::one(connection, "connection")? };
        handle.write(core::ptr::null_mut());
        check_layout(layout)?;
        // SAFETY: as before.
        let (location, robot) = unsafe { read_place(place)? };
        let opened = Connection::open_within(&location, &robot, ns(timeout_ns))?;
        handle.write_result(handles::store(Session::new(opened)))
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_close(connection: *mut Session) -> c_int {
    call(|| handles::close(connection))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_status(
    connection: *mut Session,
    timeout_ns: u64,
    status: *mut Status,
) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let out = unsafe { Out::one(status, "status")? };
        out.write_result(handles::with(connection, |session| {
            session.status(ns(timeout_ns))
        }))
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_request(
    connection: *mut Session,
    kind: u32,
    timeout_ns: u64,
    response: *mut Response,
) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let out = unsafe { Out::one_or_none(response, "response")? };
        let kind: RequestKind = read_code(kind, "kind")?;
        let asked = handles::with(connection, |session| session.request(kind, ns(timeout_ns)));
        answer(asked, &out)
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_reset(
    connection: *mut Session,
    accept_pose: u32,
    timeout_ns: u64,
    response: *mut Response,
) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let out = unsafe { Out::one_or_none(response, "response")? };
        let (accepts, timeout) = (accept_pose != 0, ns(timeout_ns));
        let asked = handles::with(connection, |session| session.reset(accepts, timeout));
        answer(asked, &out)
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_feed(
    connection: *mut Session,
    mode: u32,
    interpolation: u32,
    points: *const ReferencePoint,
    count: usize,
    header: *mut Header,
) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let out = unsafe { Out::one_or_none(header, "header")? };
        let mode: ChunkMode = read_code(mode, "mode")?;
        let interpolation: Interpolation = read_code(interpolation, "interpolation")?;
        // SAFETY: as before.
        let points = unsafe { read_array(points, count, CHUNK_POINTS_MAX, "points")? };
        out.write_result(handles::with(connection, |session| {
            session.feed(mode, interpolation, points)
        }))
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_obstacles(
    connection: *mut Session,
    action: u32,
    obstacles: *const Obstacle,
    count: usize,
    header: *mut Header,
) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let out = unsafe { Out::one_or_none(header, "header")? };
        let action: ObstacleAction = read_code(action, "action")?;
        // SAFETY: as before.
        let obstacles = unsafe { read_array(obstacles, count, OBSTACLES_MAX, "obstacles")? };
        out.write_result(handles::with(connection, |session| {
            session.send_obstacles(action, obstacles)
        }))
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_send_tip(
    connection: *mut Session,
    measured_ns: u64,
    tip_position_m: *const f64,
    header: *mut Header,
) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let out = unsafe { Out::one_or_none(header, "header")? };
        // SAFETY: as before; the header requires three numbers.
        let tip = unsafe { read_array(tip_position_m, 3, 3, "tip_position_m")? };
        let tip_position_m = [tip[0], tip[1], tip[2]];
        out.write_result(handles::with(connection, |session| {
            session.send_tip(measured_ns, tip_position_m)
        }))
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_telemetry_open(connection: *mut Session) -> c_int {
    call(|| handles::with(connection, Session::open_telemetry))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_telemetry_read(
    connection: *mut Session,
    timeout_ns: u64,
    records: *mut Telemetry,
    capacity: usize,
    count: *mut usize,
    lost: *mut u64,
) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let out = unsafe { Out::array(records, capacity, "records")? };
        // SAFETY: as before.
        let read = unsafe { Out::one(count, "count")? };
        // SAFETY: as before.
        let missing = unsafe { Out::one_or_none(lost, "lost")? };
        read.write(0);
        let (count, lost) = handles::with(connection, |session| {
            session.read_telemetry(capacity, ns(timeout_ns), |index, record| {
                out.write_at(index, record);
            })
        })?;
        read.write(count);
        missing.write(lost);
        Ok(if count == 0 { Code::Nothing } else { Code::Ok })
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_outcome(
    connection: *mut Session,
    kind: u32,
    header: *const Header,
    timeout_ns: u64,
    event: *mut InputEvent,
) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let out = unsafe { Out::one(event, "event")? };
        // SAFETY: as before.
        let header = unsafe { read(header, "header")? };
        let kind: EventKind = read_code(kind, "kind")?;
        out.write_result(handles::with(connection, |session| {
            session.event_on(kind, &header, ns(timeout_ns))
        }))
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_driver_connect(
    layout: u64,
    place: *const Place,
    interface: u32,
    timeout_ns: u64,
    driver: *mut *mut Driver,
) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let handle = unsafe { Out::one(driver, "driver")? };
        handle.write(core::ptr::null_mut());
        check_layout(layout)?;
        let interface = read_interface(interface)?;
        // SAFETY: as before.
        let (location, robot) = unsafe { read_place(place)? };
        let opened = Driver::connect_within(&location, &robot, interface, ns(timeout_ns))?;
        handle.write_result(handles::store(opened))
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_driver_close(driver: *mut Driver) -> c_int {
    call(|| handles::close(driver))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_driver_robot(driver: *mut Driver, robot: *mut RobotDescription) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let out = unsafe { Out::one(robot, "robot")? };
        out.write_result(handles::with(driver, |driver| Ok(*driver.robot())))
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_driver_send(
    driver: *mut Driver,
    measurement: *const Measurement,
) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let measurement = unsafe { read(measurement, "measurement")? };
        handles::with(driver, |driver| Ok(driver.send(measurement).map(drop)?))
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_driver_send_cable_lengths(
    driver: *mut Driver,
    measured_ns: u64,
    cable_length_m: *const f64,
    count: usize,
) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let lengths_m = unsafe { read_array(cable_length_m, count, CABLES_MAX, "cable_length_m")? };
        handles::with(driver, |driver| {
            send_cable_lengths(driver, measured_ns, lengths_m)
        })
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_driver_update(driver: *mut Driver, update: *mut Update) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let out = unsafe { Out::one(update, "update")? };
        out.write_result(handles::with(driver, |driver| {
            let found = driver.update()?;
            if let Some(refusal) = found.refused {
                set_last_error(&refusal.to_string());
            }
            Ok(Update::new(&found, driver.refusals()))
        }))
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_driver_rates_at(
    driver: *mut Driver,
    now_ns: u64,
    rates: *mut Rates,
) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let out = unsafe { Out::one(rates, "rates")? };
        // Rest, also in case of an error.
        out.write(CommandedRates::default().into());
        out.write_result(handles::with(driver, |driver| {
            Ok(driver.rates_at(now_ns).into())
        }))
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_driver_position_at(
    driver: *mut Driver,
    now_ns: u64,
    position: *mut Position,
) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let out = unsafe { Out::one(position, "position")? };
        let Some(commanded) = handles::with(driver, |driver| Ok(driver.position_at(now_ns)))?
        else {
            return Ok(Code::Nothing);
        };
        out.write(commanded.into());
        Ok(Code::Ok)
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_driver_stand_at(driver: *mut Driver, place: *const Position) -> c_int {
    call(|| {
        // SAFETY: the rule of cdcr.h on pointers.
        let place = unsafe { read(place, "place")? };
        handles::with(driver, |driver| Ok(driver.stand_at(place.into())?))
    })
}

#[unsafe(no_mangle)]
unsafe extern "C" fn cdcr_driver_forget(driver: *mut Driver) -> c_int {
    call(|| {
        handles::with(driver, |driver| {
            driver.forget();
            Ok(())
        })
    })
}
