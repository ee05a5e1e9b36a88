//! When bytes arrived, as opposed to when they were read: a process that was stopped, starved or suspended reads what is old.
//!
//! A datagram carries the kernel's own stamp where the kernel gives one (SO_TIMESTAMPNS). It is of the time of day, which may be set, so
//! only its age counts, and that has bounds: nothing lay in a socket before the socket was last found empty, and nothing arrives later than
//! it is read. A stream of bytes has no such stamps. What is read from it arrived just now, unless the process has had a pause: what is read
//! then may be as old as the pause, and is taken to be, until the stream had to be waited for. Datagrams that the kernel had no room for are told
//! with the next one (SO_RXQ_OVFL).

use std::io::{self, IoSliceMut};
use std::net::{SocketAddr, SocketAddrV4, SocketAddrV6};
use std::os::fd::AsRawFd;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use nix::sys::socket::{ControlMessageOwned, MsgFlags, SockaddrStorage, recvmsg, setsockopt, sockopt};
use nix::sys::time::TimeSpec;
use tokio::io::{AsyncRead, AsyncReadExt, Interest};
use tokio::net::UdpSocket;
use tokio::time::{MissedTickBehavior, interval};

use crate::time::{Companion, Span, Stamp};
use crate::wire::companion_clock::CompanionClock;

/// The process shows that it runs this often …
const BEAT: Duration = Duration::from_millis(20);
/// … and was stopped or starved when it has not for so long.
const PAUSE: Span = Span::from_millis(60);

/// A stream that had to be waited for so long holds nothing old any more. What a terminal holds back comes sooner.
const WAITED: Span = Span::from_millis(2);
/// A pause that ended so long ago has left nothing that is read only now.
const PAST: Span = Span::from_millis(1000);
/// Two pauses with less between them are one: there was no time to read everything.
const ONE_PAUSE: Span = Span::from_millis(100);

/// When the process has attended to its links, and when it could not. Every link reads it, and tells it.
#[derive(Debug)]
pub(super) struct Attendance {
    clock: CompanionClock,
    last_us: AtomicI64,
    /// The newest pause, from and to.
    pause_us: [AtomicI64; 2],
}

impl Attendance {
    pub(super) fn new(clock: CompanionClock) -> Self {
        let now = clock.now().micros();
        Self { clock, last_us: now.into(), pause_us: [now.into(), now.into()] }
    }

    /// The time now.
    pub(super) fn now(&self) -> Stamp<Companion> {
        self.clock.now()
    }

    /// The time of day, µs since 1970.
    pub(super) fn unix_us(&self) -> i64 {
        self.clock.unix_us()
    }

    /// The time now, at which the links are attended to.
    fn attend(&self) -> Stamp<Companion> {
        let now = self.clock.now();
        let last = Stamp::from_micros(self.last_us.swap(now.micros(), Ordering::AcqRel));
        if now - last > PAUSE {
            if last - self.pause().1 > ONE_PAUSE {
                self.pause_us[0].store(last.micros(), Ordering::Release);
            }
            self.pause_us[1].store(now.micros(), Ordering::Release);
        }
        now
    }

    /// The newest pause, from and to.
    fn pause(&self) -> (Stamp<Companion>, Stamp<Companion>) {
        let [from, to] = [0, 1].map(|i| Stamp::from_micros(self.pause_us[i].load(Ordering::Acquire)));
        (from, to)
    }

    /// Shows that the process runs, for ever.
    pub(super) async fn beat(&self) {
        let mut beat = interval(BEAT);
        beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            beat.tick().await;
            self.attend();
        }
    }

    /// How long ago the kernel stamped something, by the time of day.
    fn age(&self, stamp: TimeSpec) -> Span {
        let us = stamp.tv_sec().saturating_mul(1_000_000).saturating_add(stamp.tv_nsec() / 1000);
        Span::from_micros(self.clock.unix_us().saturating_sub(us))
    }
}

/// What may lie in a stream since a pause.
#[derive(Clone, Copy, Debug)]
struct Backlog {
    /// When the stream was read last.
    read: Stamp<Companion>,
    /// What is read now may be as old as this.
    since: Option<Stamp<Companion>>,
}

impl Backlog {
    fn new(now: Stamp<Companion>) -> Self {
        Self { read: now, since: None }
    }

    /// When what was read just now arrived, at the earliest.
    fn arrived(&mut self, attendance: &Attendance) -> Stamp<Companion> {
        let now = attendance.attend();
        let (from, to) = attendance.pause();
        if now - to > PAST {
            self.since = None;
        } else if self.read < to {
            self.since = Some(self.since.map_or(from, |since| since.min(from)));
        } else if now - self.read > WAITED {
            self.since = None;
        }
        self.read = now;
        self.since.unwrap_or(now)
    }
}

/// When what a stream of bytes holds arrived.
#[derive(Debug)]
pub(super) struct StreamArrivals<'a> {
    attendance: &'a Attendance,
    backlog: Backlog,
}

impl<'a> StreamArrivals<'a> {
    /// Of a stream that was opened just now.
    pub(super) fn new(attendance: &'a Attendance) -> Self {
        Self { attendance, backlog: Backlog::new(attendance.now()) }
    }

    /// Reads into `space`: how many bytes, and when they arrived. Cancelling this loses nothing.
    ///
    /// # Errors
    /// Those of the stream.
    pub(super) async fn read<R: AsyncRead + Unpin>(
        &mut self,
        stream: &mut R,
        space: &mut [u8],
    ) -> io::Result<(usize, Stamp<Companion>)> {
        let n = stream.read(space).await?;
        Ok((n, self.backlog.arrived(self.attendance)))
    }
}

/// A datagram that came.
#[derive(Clone, Copy, Debug)]
pub(super) struct Datagram {
    pub(super) len: usize,
    pub(super) from: Option<SocketAddr>,
    pub(super) arrived: Stamp<Companion>,
    /// Datagrams before it that the kernel had no room for.
    pub(super) dropped: u32,
}

/// Receives datagrams with the kernel's stamps.
#[derive(Debug)]
pub(super) struct DatagramArrivals<'a> {
    attendance: &'a Attendance,
    socket: &'a UdpSocket,
    /// Where the kernel writes its stamps.
    ancillary: Vec<u8>,
    /// What the kernel has dropped of the socket, as it has told.
    dropped: u32,
    /// When the socket was last found empty.
    empty: Stamp<Companion>,
    backlog: Backlog,
}

impl<'a> DatagramArrivals<'a> {
    /// Of a socket that was opened just now. A kernel without stamps is put up with.
    pub(super) fn new(attendance: &'a Attendance, socket: &'a UdpSocket) -> Self {
        if let Err(e) = setsockopt(socket, sockopt::ReceiveTimestampns, &true) {
            tracing::debug!("datagrams are stamped when they are read: {e}");
        }
        if let Err(e) = setsockopt(socket, sockopt::RxqOvfl, &1) {
            tracing::debug!("datagrams that the kernel drops are not counted: {e}");
        }
        let now = attendance.now();
        Self {
            attendance,
            socket,
            ancillary: nix::cmsg_space!(TimeSpec, u32),
            dropped: 0,
            empty: now,
            backlog: Backlog::new(now),
        }
    }

    /// Waits for the next datagram. Cancelling this loses nothing.
    ///
    /// # Errors
    /// Those of the socket.
    pub(super) async fn receive(&mut self, buffer: &mut [u8]) -> io::Result<Datagram> {
        let (attendance, socket) = (self.attendance, self.socket);
        let (ancillary, empty) = (&mut self.ancillary, &mut self.empty);
        let (len, from, told) = socket
            .async_io(Interest::READABLE | Interest::ERROR, || {
                let received = receive(socket, buffer, ancillary);
                if received.as_ref().is_err_and(|e| e.kind() == io::ErrorKind::WouldBlock) {
                    *empty = attendance.attend();
                }
                received
            })
            .await?;
        let read = self.backlog.arrived(attendance);
        let now = attendance.now();
        let arrived =
            told.stamp.map_or(read, |stamp| (now - attendance.age(stamp)).clamp(self.empty.min(now), now));
        // The number counts on from when the socket was opened, and begins again after 2³².
        let before = told.dropped.map_or(self.dropped, |now| std::mem::replace(&mut self.dropped, now));
        let dropped = self.dropped.wrapping_sub(before);
        Ok(Datagram { len, from, arrived, dropped })
    }
}

/// What the kernel says beside a datagram.
#[derive(Clone, Copy, Debug, Default)]
struct BesideDatagram {
    stamp: Option<TimeSpec>,
    dropped: Option<u32>,
}

/// One datagram: its length, its sender and what the kernel says of it.
fn receive(
    socket: &UdpSocket,
    buffer: &mut [u8],
    ancillary: &mut [u8],
) -> io::Result<(usize, Option<SocketAddr>, BesideDatagram)> {
    let mut slices = [IoSliceMut::new(buffer)];
    let flags = MsgFlags::MSG_DONTWAIT;
    let message = recvmsg::<SockaddrStorage>(socket.as_raw_fd(), &mut slices, Some(ancillary), flags)?;
    let mut told = BesideDatagram::default();
    for c in message.cmsgs().into_iter().flatten() {
        match c {
            ControlMessageOwned::ScmTimestampns(stamp) => told.stamp = Some(stamp),
            ControlMessageOwned::RxqOvfl(dropped) => told.dropped = Some(dropped),
            _ => {}
        }
    }
    Ok((message.bytes, message.address.as_ref().and_then(address), told))
}

fn address(storage: &SockaddrStorage) -> Option<SocketAddr> {
    let v4 = storage.as_sockaddr_in().map(|a| SocketAddrV4::from(*a).into());
    v4.or_else(|| storage.as_sockaddr_in6().map(|a| SocketAddrV6::from(*a).into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: i64) -> Stamp<Companion> {
        Stamp::from_micros(ms * 1000)
    }

    /// A clock that begins at 1 s, and the attendance by it.
    fn attended() -> (CompanionClock, Attendance) {
        let clock = CompanionClock::manual(at(1000));
        (clock.clone(), Attendance::new(clock))
    }

    /// Passes time as a process does that runs.
    fn runs(clock: &CompanionClock, attendance: &Attendance, ms: i64) {
        for _ in 0..ms {
            clock.advance(Span::from_millis(1));
            attendance.attend();
        }
    }

    #[test]
    fn what_is_read_after_a_pause_may_be_as_old_as_the_pause() {
        let (clock, attendance) = attended();
        let mut backlog = Backlog::new(at(1000));
        runs(&clock, &attendance, 200);
        assert_eq!(backlog.arrived(&attendance), at(1200));
        clock.advance(Span::from_millis(2000));
        // The beat may come before the first read, and reading takes its time.
        assert_eq!(attendance.attend(), at(3200));
        for _ in 0..3 {
            assert_eq!(backlog.arrived(&attendance), at(1200));
            runs(&clock, &attendance, 1);
        }
        // It had to be waited for.
        runs(&clock, &attendance, 4);
        assert_eq!(backlog.arrived(&attendance), at(3207));
    }

    #[test]
    fn a_second_pause_makes_nothing_newer() {
        let (clock, attendance) = attended();
        let mut backlog = Backlog::new(at(1000));
        for _ in 0..3 {
            clock.advance(Span::from_millis(500));
            attendance.attend();
        }
        assert_eq!(backlog.arrived(&attendance), at(1000));
        runs(&clock, &attendance, 200);
        clock.advance(Span::from_millis(100));
        assert_eq!(backlog.arrived(&attendance), at(1000), "not waited for since the pause before");
    }

    #[test]
    fn a_pause_of_long_ago_is_over() {
        let (clock, attendance) = attended();
        let mut backlog = Backlog::new(at(1000));
        clock.advance(Span::from_millis(2000));
        attendance.attend();
        runs(&clock, &attendance, 1500);
        assert_eq!(backlog.arrived(&attendance), at(4500));
        // A scheduler that is late by a few beats is no pause.
        clock.advance(Span::from_millis(50));
        assert_eq!(backlog.arrived(&attendance), at(4550));
    }

    #[tokio::test]
    async fn a_datagram_is_as_old_as_the_kernel_says_and_no_older_than_the_empty_socket() {
        let clock = CompanionClock::new();
        let attendance = Attendance::new(clock.clone());
        let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let to = socket.local_addr().unwrap();
        let mut arrivals = DatagramArrivals::new(&attendance, &socket);
        let sender = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        // The kernel begins to stamp a moment after it was first asked to.
        std::thread::sleep(Duration::from_millis(100));
        let mut buffer = [0; 100];
        let before = clock.now();
        sender.send_to(b"first", to).unwrap();
        let sent = clock.now();
        // Nobody looks for as long as this takes.
        std::thread::sleep(Duration::from_millis(300));
        let first = arrivals.receive(&mut buffer).await.unwrap();
        assert_eq!((first.len, first.from), (5, sender.local_addr().ok()));
        let slack = Span::from_millis(20);
        assert!(first.arrived > before - slack && first.arrived < sent + slack, "{first:?}, sent {sent:?}");

        // Found empty: whatever the time of day does, what comes then came then.
        let none = tokio::time::timeout(Duration::from_millis(20), arrivals.receive(&mut buffer)).await;
        assert!(none.is_err());
        let empty = arrivals.empty;
        assert!(empty >= sent);
        sender.send_to(b"2", to).unwrap();
        let second = arrivals.receive(&mut buffer).await.unwrap();
        assert!(second.arrived >= empty && second.arrived <= clock.now(), "{second:?}");
    }

    #[tokio::test]
    async fn what_the_kernel_drops_is_counted() {
        let attendance = Attendance::new(CompanionClock::new());
        let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        setsockopt(&socket, sockopt::RcvBuf, &4096).unwrap();
        let to = socket.local_addr().unwrap();
        let mut arrivals = DatagramArrivals::new(&attendance, &socket);
        let sender = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        let mut buffer = [0; 2000];
        let (mut came, mut dropped) = (0, 0);
        // Nobody reads, then somebody does; what comes after tells what is missing.
        for _ in 0..2 {
            for _ in 0..100 {
                sender.send_to(&[7; 1000], to).unwrap();
            }
            while let Ok(one) =
                tokio::time::timeout(Duration::from_millis(200), arrivals.receive(&mut buffer)).await
            {
                came += 1;
                dropped += one.unwrap().dropped;
            }
        }
        sender.send_to(&[7; 10], to).unwrap();
        let last = arrivals.receive(&mut buffer).await.unwrap();
        assert!(came < 100, "{came}");
        assert_eq!(came + dropped + last.dropped, 200);
    }

    #[test]
    fn the_age_of_a_stamp_is_by_the_time_of_day() {
        let (clock, attendance) = attended();
        clock.advance(Span::from_millis(500));
        assert_eq!(attendance.age(TimeSpec::new(1, 250_000_000)), Span::from_millis(250));
        assert_eq!(attendance.age(TimeSpec::new(9, 0)), Span::from_millis(-7500));
    }
}
