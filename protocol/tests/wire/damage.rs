//! exploration
use r4_protocol::{ToDevice,ToHost,FrameDecoder};
use serde::{Serialize,de::DeserializeOwned};
use crate::{frame,samples,strategies};
use proptest::{strategy::{Strategy,ValueTree},test_runner::TestRunner};

fn accepted<T: DeserializeOwned+core::fmt::Debug>(b:&[u8])->Option<T>{ let mut d=FrameDecoder::new(); let mut r=None; for x in b { if let Some(Ok(m))=d.push::<T>(*x) { r=Some(m);} } r }
fn flips<T: Serialize+DeserializeOwned+core::fmt::Debug>(name:&str,m:&T,depth:usize,count:&mut [usize;4],tried:&mut [usize;4]){
  let f=frame(m); let bits=(f.len()-1)*8;
  let mut g=f.clone();
  for i in 0..bits { g[i/8]^=1<<(i%8); tried[1]+=1;
    if let Some(x)=accepted::<T>(&g){count[1]+=1; println!("{name} 1: bit {i} {m:?} -> {x:?} {f:02x?} {g:02x?}");}
    if depth>1 {for j in i+1..bits { g[j/8]^=1<<(j%8); tried[2]+=1;
      if let Some(x)=accepted::<T>(&g){count[2]+=1; println!("{name} 2: bits {i} {j} {m:?} -> {x:?} {f:02x?} {g:02x?}");}
      if depth>2 {for k in j+1..bits { g[k/8]^=1<<(k%8); tried[3]+=1;
      if let Some(x)=accepted::<T>(&g){count[3]+=1; if count[3]<20 {println!("{name} 3: bits {i} {j} {k} {m:?} -> {x:?} {f:02x?} {g:02x?}");}}
      g[k/8]^=1<<(k%8);}}
      g[j/8]^=1<<(j%8);}}
    g[i/8]^=1<<(i%8);
  }
}
#[test] fn explore(){
  let t=std::time::Instant::now();
  let (mut c,mut n)=([0;4],[0;4]);
  for (name,m) in samples::to_device(){ flips(name,&m,3,&mut c,&mut n); }
  println!("device {c:?}/{n:?} {:?}",t.elapsed());
  for (name,m) in samples::to_host(){ flips(name,&m,if frame(&m).len()<20 {3} else if frame(&m).len()<100 {2} else {1},&mut c,&mut n); }
  println!("all {c:?}/{n:?} {:?}",t.elapsed());
  let mut runner=TestRunner::deterministic();
  let (mut c,mut n)=([0;4],[0;4]);
  while t.elapsed().as_secs()<60 { let m=strategies::to_device().new_tree(&mut runner).unwrap().current(); flips("rnd",&m,1,&mut c,&mut n);
   let m=strategies::to_host().new_tree(&mut runner).unwrap().current(); flips("rnd",&m,1,&mut c,&mut n); }
  println!("random {c:?}/{n:?} {:?}",t.elapsed());
}
