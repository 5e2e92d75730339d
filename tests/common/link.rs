//! A process's link to the router, which can be cut as a cable is: nothing arrives, and nobody is told.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::thread;

/// Whether the link carries anything.
#[derive(Default)]
struct Cut {
    is_cut: Mutex<bool>,
    mended: Condvar,
    is_over: AtomicBool,
}

impl Cut {
    /// Waits while the link is cut; false once it is over.
    fn carries(&self) -> bool {
        let is_cut = self.is_cut.lock().expect("no holder panics");
        drop(self.mended.wait_while(is_cut, |cut| *cut && !self.is_over.load(Ordering::SeqCst)).expect("no holder panics"));
        !self.is_over.load(Ordering::SeqCst)
    }
}

/// The link; it ends when it goes out of scope.
pub struct Link {
    endpoint: String,
    cut: Arc<Cut>,
}

impl Link {
    /// A link to `endpoint`, `tcp/…`.
    pub fn to(endpoint: &str) -> Self {
        let router = endpoint.strip_prefix("tcp/").expect("a TCP endpoint").to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let endpoint = format!("tcp/{}", listener.local_addr().expect("its address"));
        let cut = Arc::new(Cut::default());
        let state = cut.clone();
        thread::spawn(move || {
            for near in listener.incoming().map_while(Result::ok) {
                if !state.carries() {
                    return;
                }
                // A router that is away ends the link, as it would without us.
                let Ok(far) = TcpStream::connect(&router) else { continue };
                let clone = |stream: &TcpStream| stream.try_clone().expect("another handle");
                for (from, to) in [(clone(&near), clone(&far)), (far, near)] {
                    let state = state.clone();
                    thread::spawn(move || carry(from, to, &state));
                }
            }
        });
        Self { endpoint, cut }
    }

    /// Where to connect to in place of the router.
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// From now on nothing arrives.
    pub fn cut(&self) {
        *self.cut.is_cut.lock().expect("no holder panics") = true;
    }

    /// What was sent meanwhile arrives, late, and all that comes after it.
    pub fn mend(&self) {
        *self.cut.is_cut.lock().expect("no holder panics") = false;
        self.cut.mended.notify_all();
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.cut.is_over.store(true, Ordering::SeqCst);
        self.mend();
    }
}

fn carry(mut from: TcpStream, mut to: TcpStream, state: &Cut) {
    let mut buffer = vec![0; 64 << 10];
    while let Ok(count) = from.read(&mut buffer)
        && count > 0
        && state.carries()
        && to.write_all(&buffer[..count]).is_ok()
    {}
    // Either side may have gone already.
    let _ended = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
}
