use core::fmt::Debug;

use cdcr_shared_types::{
    Command, Header, Incident, Measurement, ObstacleUpdate, ReferenceChunk, Service, Status,
    Telemetry,
};
use iceoryx2::prelude::ZeroCopySend;

mod sealed {
    pub trait Sealed {}
}

/// Payload of a publish-subscribe service. The set is closed: it is the wire contract.
pub trait Message: sealed::Sealed + Copy + Debug + Default + ZeroCopySend + 'static {
    /// The service of this message.
    const SERVICE: Service;

    /// Sender, sequence number and time.
    fn header(&self) -> &Header;

    /// Replaces the header; called by the ports on sending.
    fn set_header(&mut self, header: Header);
}

macro_rules! messages {
    ($($payload:ident => $service:ident,)+) => { $(
        impl sealed::Sealed for $payload {}

        impl Message for $payload {
            const SERVICE: Service = Service::$service;

            fn header(&self) -> &Header {
                &self.header
            }

            fn set_header(&mut self, header: Header) {
                self.header = header;
            }
        }
    )+ };
}

messages! {
    ReferenceChunk => Reference,
    ObstacleUpdate => Obstacles,
    Measurement => Measurement,
    Command => Command,
    Telemetry => Telemetry,
    Status => Status,
    Incident => Incidents,
}
