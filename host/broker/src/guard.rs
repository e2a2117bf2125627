//! Guard of a shared board: the action and the resources of each request, and the policy's decision about it.

use std::cell::RefCell;

use r4_access::{Action, Class, Guard, Request as Asked, Resource};
use r4_protocol::{ChannelId, Request};

/// Guard with the clock that it decides by.
pub struct Guarded {
    guard: RefCell<Guard>,
    now_ms: Box<dyn Fn() -> u64>,
}

impl Guarded {
    /// Makes a guarded board's guard. `now_ms` is the time by which tokens are judged, Unix ms.
    #[must_use]
    pub fn new(guard: Guard, now_ms: impl Fn() -> u64 + 'static) -> Self {
        Self { guard: RefCell::new(guard), now_ms: Box::new(now_ms) }
    }

    /// Takes a token that a client presented. The client gets no answer: its next request shows the result.
    pub(crate) fn present(&self, client: u64, token: &str) {
        // The guard has logged why a token was not valid.
        let _ = self.guard.borrow_mut().present(client, token, (self.now_ms)());
    }

    /// Decides about a client's request. All of its parts have to be granted.
    pub(crate) fn permits(&self, client: u64, asked: &[Asked]) -> bool {
        let (mut guard, now_ms) = (self.guard.borrow_mut(), (self.now_ms)());
        // Without an early end: each part is logged, and the time does not say which was denied.
        asked.iter().fold(true, |is, asked| guard.decide(client, asked, now_ms).is_granted() & is)
    }

    /// True while a client's token is valid.
    pub(crate) fn is_authenticated(&self, client: u64) -> bool {
        self.guard.borrow_mut().is_authenticated(client, (self.now_ms)())
    }

    pub(crate) fn leave(&self, client: u64) {
        self.guard.borrow_mut().leave(client, (self.now_ms)());
    }
}

/// Returns the permissions that a request needs. The match has no wildcard, so that each new request has to be
/// classified.
///
/// Sessions, the list of channels, stops, disarming and the end of a stream need none: safety does not wait for
/// authorisation, and a client has to know the channels before it has a session in which it can disarm.
pub(crate) fn needs(request: &Request) -> Vec<Asked> {
    let one = |action, resource| vec![Asked { action, resource }];
    let whole = |action, class| one(action, Resource::whole(class));
    match request {
        Request::Hello { .. }
        | Request::Bye
        | Request::Describe { .. }
        | Request::Stop
        | Request::Disarm
        | Request::Log { on: false }
        | Request::Subscribe { period_ms: 0, .. } => Vec::new(),
        Request::Subscribe { channel, .. } => vec![of_channel(Action::Read, *channel)],
        Request::Set { channel, .. } | Request::Follow { channel, .. } => vec![of_channel(Action::Set, *channel)],
        Request::Bind { channels, .. } => channels.iter().map(|bound| of_channel(Action::Set, bound.channel)).collect(),
        Request::Log { on: true } => whole(Action::Read, Class::Log),
        Request::Stats | Request::Image => whole(Action::Read, Class::Statistics),
        Request::Fault { .. } | Request::FaultSnapshot { .. } => whole(Action::Read, Class::Faults),
        // Parameters are described by their place in a list, which says nothing about which one it is.
        Request::DescribeParameter { .. } => whole(Action::Read, Class::Configuration),
        Request::SetParameter { key, .. } => {
            one(Action::Configure, Resource::new(Class::Configuration, key.to_string()))
        }
        Request::SetGains { channel, .. } | Request::SetTuning { channel, .. } => {
            one(Action::Configure, Resource::new(Class::Configuration, channel.to_string()))
        }
        Request::SetName { .. } | Request::SaveParameters | Request::ResetParameters => {
            whole(Action::Configure, Class::Configuration)
        }
        Request::Arm => whole(Action::Arm, Class::Board),
        Request::Clear => whole(Action::Clear, Class::Board),
        Request::Restart | Request::Bootloader => whole(Action::Configure, Class::Board),
        Request::I2cTransfer { bus, .. } => one(Action::Transfer, Resource::new(Class::Bus, format!("i2c{bus}"))),
        Request::UartWrite { port, .. } | Request::UartRead { port } => {
            one(Action::Transfer, Resource::new(Class::Bus, format!("uart{port}")))
        }
    }
}

fn of_channel(action: Action, channel: ChannelId) -> Asked {
    Asked { action, resource: Resource::new(Class::Channel, channel.to_string()) }
}
