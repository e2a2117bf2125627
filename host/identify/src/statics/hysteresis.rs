//! Play of a held shaft that is pulled from both sides.
