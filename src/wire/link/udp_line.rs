//! Sockets that the kernel keeps apart: a line of its own for the pinned peer.
//!
//! Of two UDP sockets at one address the kernel gives a datagram to the one that is connected to its sender. So a peer that is pinned gets
//! a buffer of its own, and what strangers send fills another, from where it pushes out nothing of the peer's.

use std::io;
use std::net::SocketAddr;
use std::os::fd::{AsFd, AsRawFd};

use nix::sys::socket::{
    AddressFamily, SockFlag, SockType, SockaddrStorage, bind, connect, setsockopt, socket, sockopt,
};
use tokio::net::UdpSocket;

/// What a socket is asked to hold, bytes: 80 ms of a flood of 50 MB/s. The kernel gives what `net.core.rmem_max` allows.
const BUFFER: usize = 4 << 20;

/// Asks for a large buffer, and puts up with less.
pub(super) fn make_roomy(socket: &impl AsFd) {
    // The first is for root alone, and goes beyond what others may ask for.
    if setsockopt(socket, sockopt::RcvBufForce, &BUFFER).is_err() {
        let _ = setsockopt(socket, sockopt::RcvBuf, &BUFFER);
    }
}

/// Opens another socket at the address of `door`, connected to `peer`.
///
/// Until it is connected it may be given others' datagrams, so whose they are must be looked at all the same. While it is made, and not
/// longer, other programs of the same user could bind to the address.
///
/// # Errors
/// Those of the system; the door is then as before.
pub(super) fn open_line(door: &UdpSocket, peer: SocketAddr) -> io::Result<UdpSocket> {
    let local = door.local_addr()?;
    let family = if local.is_ipv4() { AddressFamily::Inet } else { AddressFamily::Inet6 };
    let flags = SockFlag::SOCK_CLOEXEC | SockFlag::SOCK_NONBLOCK;
    let line = socket(family, SockType::Datagram, flags, None)?;
    make_roomy(&line);
    setsockopt(&line, sockopt::ReusePort, &true)?;
    setsockopt(door, sockopt::ReusePort, &true)?;
    let made = bind(line.as_raw_fd(), &SockaddrStorage::from(local))
        .and_then(|()| connect(line.as_raw_fd(), &SockaddrStorage::from(peer)));
    // All that is bound there must allow it, so the door alone keeps others out.
    setsockopt(door, sockopt::ReusePort, &false)?;
    made?;
    UdpSocket::from_std(line.into())
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    async fn bound(address: &str) -> UdpSocket {
        UdpSocket::bind(address).await.unwrap()
    }

    async fn received(socket: &UdpSocket) -> Option<Vec<u8>> {
        let mut buffer = [0; 2000];
        let n = tokio::time::timeout(Duration::from_secs(5), socket.recv(&mut buffer)).await.ok()?.ok()?;
        Some(buffer[..n].to_vec())
    }

    #[tokio::test]
    async fn the_kernel_sorts_the_peers_datagrams_to_its_line() {
        for address in ["127.0.0.1:0", "[::1]:0"] {
            let door = bound(address).await;
            let to = door.local_addr().unwrap();
            let (peer, stranger) = (bound(address).await, bound(address).await);
            let line = open_line(&door, peer.local_addr().unwrap()).unwrap();
            assert_eq!(line.local_addr().unwrap(), to);
            stranger.send_to(b"stranger", to).await.unwrap();
            peer.send_to(b"peer", to).await.unwrap();
            assert_eq!(received(&line).await.as_deref(), Some(&b"peer"[..]));
            assert_eq!(received(&door).await.as_deref(), Some(&b"stranger"[..]));
            line.send(b"answer").await.unwrap();
            assert_eq!(received(&peer).await.as_deref(), Some(&b"answer"[..]));

            // A flood at the door, which nobody reads, takes nothing from the line.
            for _ in 0..3000 {
                let _ = stranger.try_send_to(&[0xFE; 1400], to);
            }
            peer.send_to(b"still", to).await.unwrap();
            assert_eq!(received(&line).await.as_deref(), Some(&b"still"[..]));

            // A line to another peer does not mind this one.
            drop(open_line(&door, stranger.local_addr().unwrap()).unwrap());
            // Nobody else can bind there meanwhile, and the door serves the peer again when the line is closed.
            assert!(UdpSocket::bind(to).await.is_err());
            drop(line);
            while door.try_recv(&mut [0; 2000]).is_ok() {}
            peer.send_to(b"again", to).await.unwrap();
            assert_eq!(received(&door).await.as_deref(), Some(&b"again"[..]));
        }
    }
}
