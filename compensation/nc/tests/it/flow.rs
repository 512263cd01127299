//! O-words: what is corrected alike stays, what is corrected differently from time to time is written out.

use crate::identity::compensated;

fn text(errors: &str, program: &str) -> String {
    let (out, _) = compensated(errors, program.as_bytes()).expect("compensated");
    String::from_utf8(out).expect("text")
}

const PROGRAM: &str = "\
O100 sub (a square)
  G91 G1 F200 X[#1]
  Y#1
  X-#1
  Y-#1
  G90
O100 endsub
G90 G0 X0 Y0 Z0
O100 call [10]
#5=0
O101 while [#5 LT 3]
  G0 X[#5*100] Y0
  O100 call [10]
  #5=[#5+1]
O101 endwhile
O102 if [#5 EQ 3]
G0 Z5
O102 else
G0 Z9
O102 endif
M2
";

#[test]
fn without_errors_nothing_changes() {
    assert_eq!(text("", PROGRAM), PROGRAM);
    let constant = "[errors]\nEXX = { poly = [10.0] }\n";
    // The same everywhere: every place is passed with one correction, so that the loop stays.
    let out = text(constant, "O1 repeat [3]\nG91 G0 X10\nO1 endrepeat\nM2\n");
    assert_eq!(out, "O1 repeat [3]\nG91 G0 X10\nO1 endrepeat\nM2\n");
}

#[test]
fn what_is_corrected_differently_is_written_out() {
    let scale = "[errors]\nEXX = { poly = [0.0, 0.1] }\n";
    let out = text(scale, PROGRAM);
    assert_eq!(
        out,
        "\
O100 sub (a square)
  G91 G1 F200 X9.999
  Y#1
  X-9.999
  Y-#1
  G90
O100 endsub
G90 G0 X0 Y0 Z0
O100 call [10]
#5=0
;O101 while [#5 LT 3]
;  G0 X[#5*100] Y0
;  O100 call [10]
;  #5=[#5+1]
;O101 endwhile
  G0 X0 Y0
  G91 G1 F200 X9.999
  Y10
  X-9.999
  Y-10
  G90
  #5=[#5+1]
  G0 X99.990 Y0
  G91 G1 F200 X9.999
  Y10
  X-9.999
  Y-10
  G90
  #5=[#5+1]
  G0 X199.980 Y0
  G91 G1 F200 X9.999
  Y10
  X-9.999
  Y-10
  G90
  #5=[#5+1]
O102 if [#5 EQ 3]
G0 Z5
O102 else
G0 Z9
O102 endif
M2
"
    );
}

#[test]
fn what_does_not_fit_together_says_so() {
    let cases = [
        (
            "O1 while [1]\nG4 P1\nO1 endwhile\n",
            "line 2: more than 1000000 blocks are executed (a loop without an end?); --max-blocks allows more",
        ),
        (
            "O1 while [1]\n",
            "line 1: what begins here does not end in the program",
        ),
        (
            "O1 endif\n",
            "line 1: o1 ends or goes on here what did not begin before, or what lies in it has not ended",
        ),
        (
            "O1 call\n",
            "line 1: the subroutine o<1> is not in this program",
        ),
        (
            "O1 sub\nO1 call\nO1 endsub\nO1 call\n",
            "line 2: more than 100 subroutines call one another",
        ),
        (
            "O1 if [#5061 GT 0]\nO1 endif\n",
            "line 1: which lines are executed after this one is only known at the machine",
        ),
        ("O1 break\n", "line 1: there is no loop o1 around this line"),
        (
            "O1 nothing\n",
            "line 1: expected a word such as sub, call, while, if or repeat after the name of an O-word",
        ),
    ];
    for (program, expected) in cases {
        let error = compensated("", program.as_bytes()).expect_err("refused");
        assert_eq!(error.to_string(), expected);
    }
}
