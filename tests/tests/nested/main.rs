//! Whole systems in the nested lab. They are one program, so that there are always as many at work as
//! there are CPUs.

mod carried;
mod change;
mod clocks;
mod control;
mod device_memory;
mod devices;
mod disk;
mod doctor;
mod evidence;
mod functional;
mod hardware;
mod health;
mod health_table;
mod hostile;
mod isolation;
mod linux_guest;
mod linux_ports;
mod load;
mod network;
mod passthrough;
mod points;
mod ports;
mod power_off;
mod process_image;
mod programs;
mod quiet;
mod safe_values;
mod sandbox;
mod several_cpus;
mod st;
mod stalls;
mod tasks;
mod timing;
mod vfio;
mod vmx;
