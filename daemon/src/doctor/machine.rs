//! What kind of machine this is.

use super::{Assessed, Assessment, Scene};

checks! {
    RealTime clock_source, "clock source",
        "The loop reads the clock thousands of times a second; the slow ones cost microseconds each time.";
    RealTime virtual_machine, "virtual machine",
        "A hypervisor may halt a core for milliseconds at any time, and nothing inside can prevent it.";
}

/// Clocks that are read without a system call.
const FAST: [&str; 9] = [
    "tsc",
    "kvm-clock",
    "hyperv_clocksource_tsc_page",
    "xen",
    "arch_sys_counter",
    "riscv_clocksource",
    "timebase",
    "tod",
    "stp",
];
/// Clocks that are read from a device, or count ticks.
const SLOW: [&str; 6] = [
    "hpet",
    "acpi_pm",
    "jiffies",
    "refined-jiffies",
    "pit",
    "hyperv_clocksource_msr",
];

fn clock_source(scene: &Scene) -> Assessed {
    let folder = "/sys/devices/system/clocksource/clocksource0";
    let current = scene
        .system
        .read(&format!("{folder}/current_clocksource"))?;
    if FAST.contains(&&*current) {
        return Ok(Assessment::ok(current));
    }
    if !SLOW.contains(&&*current) {
        let value = format!("{current}: its speed is not known here");
        let remedy = format!("cat {folder}/available_clocksource");
        return Ok(Assessment::unknown(value, remedy));
    }
    let available = scene
        .system
        .read(&format!("{folder}/available_clocksource"))?;
    let better = available
        .split_whitespace()
        .find(|name| FAST.contains(name));
    Ok(match better {
        Some(better) => Assessment::warning(
            format!("{current}, though {better} is there"),
            format!("echo {better} | sudo tee {folder}/current_clocksource"),
        ),
        None => Assessment::warning(
            format!("{current}; there is no fast one"),
            "look for `clocksource` in dmesg; if only the kernel's doubt is in the way, boot with tsc=reliable",
        ),
    })
}

fn virtual_machine(scene: &Scene) -> Assessed {
    let system = &scene.system;
    let processor = system.read("/proc/cpuinfo")?;
    let has_flag = processor
        .lines()
        .filter(|line| line.starts_with("flags"))
        .any(|line| line.split_whitespace().any(|flag| flag == "hypervisor"));
    let product = ["sys_vendor", "product_name"].map(|name| {
        let path = format!("/sys/class/dmi/id/{name}");
        system
            .read_if_there(&path)
            .ok()
            .flatten()
            .unwrap_or_default()
    });
    let product = product.join(" ").trim().to_owned();
    let known = [
        "KVM",
        "QEMU",
        "VMware",
        "VirtualBox",
        "Virtual Machine",
        "Xen",
    ];
    if !has_flag && !known.iter().any(|name| product.contains(name)) {
        return Ok(Assessment::ok("no"));
    }
    let kind = if product.is_empty() {
        "of unknown make".to_owned()
    } else {
        product
    };
    Ok(Assessment::warning(
        format!("yes, {kind}"),
        "run on the machine itself, or pin this virtual machine to cores of its own",
    ))
}
