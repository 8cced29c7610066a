//! Tells the library when it was built (the self-test's report shows it); `SOURCE_DATE_EPOCH` fixes the time
//! for reproducible builds.

use std::time::{SystemTime, UNIX_EPOCH};

fn main() {
    println!("cargo::rerun-if-env-changed=SOURCE_DATE_EPOCH");
    println!("cargo::rerun-if-changed=src");
    let given = std::env::var("SOURCE_DATE_EPOCH").ok();
    let given = given.and_then(|text| text.parse::<u64>().ok());
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH);
    let now = since_1970.map_or(0, |span| span.as_secs());
    println!(
        "cargo::rustc-env=WINDLASS_BUILD_SECONDS={}",
        given.unwrap_or(now)
    );
}
