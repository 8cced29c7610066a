//! The Talon SRX dialect on the virtual bench, frame by frame. Rows are those of the table in
//! `docs/talon-srx-rows.md`.

mod bench;
mod drive;
mod limits;
mod sensors;
mod status;
