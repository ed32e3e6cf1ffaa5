//! What a run used, processor time over all threads and peak memory, and what memory it may still use.

use std::sync::OnceLock;
use std::time::Instant;

/// Milliseconds of processor time that this process has used, over all its threads. Where the system does not tell,
/// wall time since the first call: compare such figures on one thread only.
pub fn cpu_ms() -> f64 {
    process_cpu_ms().unwrap_or_else(|| {
        static START: OnceLock<Instant> = OnceLock::new();
        START.get_or_init(Instant::now).elapsed().as_secs_f64() * 1e3
    })
}

#[cfg(unix)]
fn process_cpu_ms() -> Option<f64> {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the clock fills the one timespec that it is handed.
    let status = unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut time) };
    (status == 0).then_some(time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 * 1e-6)
}

#[cfg(not(unix))]
fn process_cpu_ms() -> Option<f64> {
    None
}

/// The most memory that this process ever held, in bytes, where the system tells.
pub fn peak_memory_bytes() -> Option<u64> {
    peak_resident_bytes()
}

#[cfg(target_os = "linux")]
fn peak_resident_bytes() -> Option<u64> {
    const BYTES_PER_KIB: u64 = 1024; // the kernel's `kB` are kibibytes
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kibibytes.checked_mul(BYTES_PER_KIB)
}

#[cfg(all(unix, not(target_os = "linux")))]
fn peak_resident_bytes() -> Option<u64> {
    // Apple counts bytes, the other systems kibibytes.
    const BYTES_PER_UNIT: u64 = if cfg!(target_vendor = "apple") { 1 } else { 1024 };
    // SAFETY: an all-zero rusage is valid, and getrusage fills the one that it is handed.
    let (status, usage) = unsafe {
        let mut usage: libc::rusage = std::mem::zeroed();
        (libc::getrusage(libc::RUSAGE_SELF, &mut usage), usage)
    };
    (status == 0).then(|| u64::try_from(usage.ru_maxrss).ok()?.checked_mul(BYTES_PER_UNIT)).flatten()
}

#[cfg(not(unix))]
fn peak_resident_bytes() -> Option<u64> {
    None
}

/// The memory in bytes that this process can still take without pushing others out, where the system tells: what the
/// machine has free, or what its container's limit leaves, if that is less.
pub fn available_memory_bytes() -> Option<u64> {
    available_bytes()
}

#[cfg(target_os = "linux")]
fn available_bytes() -> Option<u64> {
    const BYTES_PER_KIB: u64 = 1024;
    let machine = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = machine.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let free = line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(BYTES_PER_KIB)?;
    // Control groups, version 2: "max" where there is no limit.
    let number = |path: &str| std::fs::read_to_string(path).ok()?.trim().parse::<u64>().ok();
    let of_container = number("/sys/fs/cgroup/memory.max")
        .zip(number("/sys/fs/cgroup/memory.current"))
        .map(|(limit, used)| limit.saturating_sub(used));
    Some(of_container.map_or(free, |left| left.min(free)))
}

#[cfg(not(target_os = "linux"))]
fn available_bytes() -> Option<u64> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processor_time_counts_every_thread() {
        let before = cpu_ms();
        let wall = Instant::now();
        std::thread::scope(|scope| {
            for _ in 0..2 {
                scope.spawn(|| {
                    let start = Instant::now();
                    let mut sum = 0u64;
                    while start.elapsed().as_millis() < 40 {
                        sum = std::hint::black_box(sum.wrapping_add(1));
                    }
                });
            }
        });
        let used = cpu_ms() - before;
        // Both threads together, on a machine that may be busy; never more than every core all the time.
        let cores = std::thread::available_parallelism().map_or(1.0, |n| n.get() as f64);
        assert!(used > 5.0, "{used}");
        assert!(used < wall.elapsed().as_secs_f64() * 1e3 * (cores + 1.0));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_machine_has_some_memory_and_no_exabyte() {
        let available = available_memory_bytes().unwrap();
        assert!(available > 1 << 20 && available < 1 << 60, "{available}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn peak_memory_grows_with_what_is_held() {
        const HELD: usize = 64 << 20;
        let mut block = vec![0u8; HELD];
        block.iter_mut().step_by(4096).for_each(|byte| *byte = 1);
        std::hint::black_box(&block);
        assert!(peak_memory_bytes().unwrap() > HELD as u64);
    }
}
